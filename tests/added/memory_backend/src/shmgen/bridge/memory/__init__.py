"""The backend of a graph within one process."""
