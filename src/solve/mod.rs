//! The radiosity system: B = S + rho F B.

mod bicgstab;

pub use bicgstab::{Solution, solve};
