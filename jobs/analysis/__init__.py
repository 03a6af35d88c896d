"""What results say: statistics, claims, figures and pages, from the stored files alone."""
