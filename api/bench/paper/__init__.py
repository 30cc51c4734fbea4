"""The seed paper's experiments: runs, tables, figures, the page."""
