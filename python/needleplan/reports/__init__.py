"""Reports: the pages and figures of results, and tables of published numbers beside computed ones."""
