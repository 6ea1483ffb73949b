"""Rates and times of the methods, compared with CasADi's IPOPT and FATROP."""
