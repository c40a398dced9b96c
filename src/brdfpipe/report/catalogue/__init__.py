"""The catalogue: one row for each material, as a dataset, as CSV, and as a page."""
