//! What the rays of a bake are traced against.

use crate::trace::RayTracer;

/// Tracers of the scene's surfaces, and of what the patches are pieces of: voxel faces or a simplified mesh, where these
/// are not the surfaces themselves.
pub(super) struct Tracers {
    pub surfaces: Box<dyn RayTracer>,
    pub faces: Option<Box<dyn RayTracer>>,
}

impl Tracers {
    /// Tracer of the scene's surfaces.
    pub fn surfaces(&self) -> &dyn RayTracer {
        &*self.surfaces
    }

    /// Tracer of what the patches are pieces of.
    pub fn patches(&self) -> &dyn RayTracer {
        self.faces.as_deref().unwrap_or(&*self.surfaces)
    }

    /// That one alone.
    pub fn into_patches(self) -> Box<dyn RayTracer> {
        self.faces.unwrap_or(self.surfaces)
    }
}
