"""Rates and times of the methods, compared with IPOPT and FATROP of CasADi."""
