"""Single-pose algorithms, recorded once as straight-line programs and printed for LLVM, C and JavaScript."""
