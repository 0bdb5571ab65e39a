"""The configuration: shmgen.toml, read into a Config that knows the line of each entry."""

from shmgen.config.file import Config, find, load

__all__ = ["Config", "find", "load"]
