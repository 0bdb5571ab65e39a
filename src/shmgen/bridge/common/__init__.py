"""Code that all backends share, and the watchdog of the bridge process."""
