"""The stage report: one page with all figures and tables."""
