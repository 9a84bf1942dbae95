"""Catalogues of others: what their columns say, what is wrong with them; a store that opens fast."""
