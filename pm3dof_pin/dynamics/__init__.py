"""Statics and dynamics of closed-chain mechanisms: holding forces, inverse dynamics, natural modes."""
