//! What a bake leaves behind: meshes, pictures and its report.

pub mod atomic;
pub mod glb;
pub mod ply;
pub mod png;
pub mod tonemap;
