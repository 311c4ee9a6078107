"""What the pages draw: one module a page."""
