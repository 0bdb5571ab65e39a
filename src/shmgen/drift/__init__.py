"""What was generated, and what has drifted since: layout.lock, its comparison, and what is said of it."""
