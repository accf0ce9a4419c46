//! Colours of patches that are already made: what another light or albedo changes of them.

use rayon::prelude::*;

use super::{Simplified, faces, patches::mean_colour, triangles};
use crate::{BakeOptions, Scene, options::PatchSource, trace::RayTracer};

impl Simplified {
    /// Gives the patches the colours that [`simplify`](super::simplify) gives them, to the bit. `scene` has the geometry
    /// that they were made of, and `tracer` holds its triangles; `options` are those that they were made with.
    pub(crate) fn colour(&mut self, scene: &Scene, options: &BakeOptions, tracer: &dyn RayTracer) {
        let patches = &mut self.patches;
        if options.patches == PatchSource::Faces {
            // Their polygons are not kept; to cut them again takes a few milliseconds.
            let again = faces(scene, self.grid, options.face_colour).patches;
            (patches.albedo, patches.emitted) = (again.albedo, again.emitted);
            return;
        }
        let groups: Vec<&[u32]> = (0..patches.len()).map(|i| patches.members(i)).collect();
        let colours: Vec<_> = match options.patches {
            PatchSource::Surfels => groups.par_iter().map(|group| mean_colour(scene, &self.fragments, group)).collect(),
            _ => triangles::colours(scene, &self.geometry, &groups, tracer),
        };
        patches.albedo = colours.iter().map(|c| c.albedo).collect();
        patches.emitted = colours.iter().map(|c| c.emitted).collect();
    }
}
