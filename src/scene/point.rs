//! Where light is asked for.

use glam::Vec3;

/// A point of a surface that receives light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Position, local.
    pub position: Vec3,
    /// Unit normal.
    pub normal: Vec3,
}
