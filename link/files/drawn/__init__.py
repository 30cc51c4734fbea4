"""A flight's report drawn: one page of HTML, or of PDF."""
