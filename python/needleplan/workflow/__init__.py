"""Work that needs several parts of the toolkit: figures and the reproduction of published results."""
