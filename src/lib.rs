//! luxel bakes diffuse global illumination on the CPU.
//!
//! It solves the radiosity equation `B = M + rho F B` on a simplified copy of the scene (equal voxels cut the
//! surfaces into patches), with form factors `F` by Monte-Carlo ray casting, and carries the result back to the
//! vertices of the original surfaces. Method: Shcherbakov & Frolov, "Automatic geometry simplification for
//! secondary illumination by radiosity"; see ARCHITECTURE.md for what differs and why.
//!
//! The pipeline, in order: scene -> simplify -> transfer -> light -> solve -> reconstruct
//! -> output.
#![deny(unsafe_code)]
#![warn(missing_docs)]

pub mod error;
pub mod options;
pub mod progress;
pub mod report;
pub mod sampling;

pub mod light;
pub mod reconstruct;
pub mod scene;
pub mod simplify;
pub mod solve;
pub mod trace;
pub mod transfer;

pub mod bake;
pub mod forecast;
pub mod output;

pub use bake::bake;
pub use error::{Error, Result};
pub use forecast::forecast;
pub use options::BakeOptions;
pub use scene::Scene;
