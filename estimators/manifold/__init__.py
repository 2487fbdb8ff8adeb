"""Compiled steps of P2's second-order filters and the SVSF, hidden states by Luenberger's transformation."""
