//! What a bake leaves behind: meshes, pictures and its report.

pub mod atomic;
pub mod camera;
pub mod exr;
pub mod glb;
pub mod layers;
pub mod ply;
pub mod png;
pub mod preview;
pub mod report;
mod sight;
pub mod tonemap;

pub use sight::{Sight, hidden_backs};
use sight::{emission, is_back};
