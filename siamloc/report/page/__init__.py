"""The report: one HTML page with everything inside it, made from result files."""
