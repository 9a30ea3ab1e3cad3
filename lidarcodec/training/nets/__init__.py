"""Networks as the papers have them. Each file is one; what trains and what uses them lies beside this package."""
