"""Read shmgen.toml into a Config. Diagnostics contain the line of the entry."""

from shmgen.config.file import Config, find, load

__all__ = ["Config", "find", "load"]
