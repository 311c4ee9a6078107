"""Pictures of the pages, one module each, and the interactive figures."""
