//! Files that a bake writes.

pub mod exr;
