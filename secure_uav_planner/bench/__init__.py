"""How good and how fast the methods are, beside CasADi with IPOPT: python -m ...bench."""
