"""Campaigns: many missions, planned on many cores or machines, and a row of results for each."""
