//! One bake on many machines.

mod slurm;
pub mod submit;
