"""Forces and motions of closed-chain mechanisms: holding forces, inverse dynamics, natural modes."""
