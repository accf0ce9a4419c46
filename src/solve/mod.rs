//! The radiosity system: B = S + rho F B.

mod bicgstab;
mod product;

pub use bicgstab::{Solution, solve};
pub(crate) use product::UNPACKED_PATCH;
