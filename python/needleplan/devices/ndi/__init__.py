"""NDI Aurora and Polaris trackers: the combined API over a serial port or TCP."""

__all__: list[str] = []
