"""Closed-chain mechanisms as data on Pinocchio: the tree, its loop closures, and one read-only configuration of it."""
