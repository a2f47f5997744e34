"""Reports: pages and figures of results, and comparisons of published with computed results."""
