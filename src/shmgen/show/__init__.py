"""Layouts as a person looks at them: tables, JSON, drawings."""
