"""Reproduction of the paper's figures and tables, each number beside that of its equations and the bound."""
