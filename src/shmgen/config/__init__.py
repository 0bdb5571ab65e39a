"""shmgen.toml, read into a Config that knows where each word of it is written."""

from shmgen.config.file import Config, find, load

__all__ = ["Config", "find", "load"]
