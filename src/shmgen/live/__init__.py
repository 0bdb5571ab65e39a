"""What speaks to live regions, for tools and bridge: which there are, who has them, which class reads them."""
