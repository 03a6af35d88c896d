"""What users run: experiments as files, from a description to Parquet, tables and figures."""
