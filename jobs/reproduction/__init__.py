"""The dissertation: all of its experiments, its claims, figures and pages."""
