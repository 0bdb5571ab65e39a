"""Services and actions of tests/cases/service, between real processes."""
