"""Descriptions that people write in YAML: every key declared once; validation, templates, editor schemas and key tables follow."""
