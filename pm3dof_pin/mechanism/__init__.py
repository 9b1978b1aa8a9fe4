"""Closed-chain mechanisms as data on Pinocchio: the tree, its loop closures, and a read-only configuration."""
