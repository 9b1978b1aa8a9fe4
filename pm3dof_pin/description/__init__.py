"""Description files read into typed, checked data: parameters, xacro, closures, and where to find them."""
