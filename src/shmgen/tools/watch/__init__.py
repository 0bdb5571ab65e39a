"""Displays lists, rates, bandwidths and delays of live topics."""
