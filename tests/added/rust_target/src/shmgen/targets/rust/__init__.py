"""Rust: `#[repr(C)]` structures that assert every offset."""
