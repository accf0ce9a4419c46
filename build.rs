//! Finds the native libraries and compiles `ffi/`; decides nothing else.

fn main() {}
