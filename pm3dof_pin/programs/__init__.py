"""Algorithms of one pose, recorded once as straight-line programs and printed for LLVM, C and JavaScript."""
