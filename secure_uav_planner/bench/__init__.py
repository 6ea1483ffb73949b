"""Rates and times of the methods, compared with CasADi and IPOPT."""
