//! Which sides of the surfaces get vertices.

use crate::{
    BakeOptions, Scene,
    options::PatchSource,
    reconstruct::PatchIndex,
    simplify::{self, NO_PATCH, Simplified, SplitMesh},
    skip::Wanted,
    trace::RayTracer,
};
/// The mesh that light is told at: sides whose patches light has `reached`, and the fronts of the rest.
pub(super) fn mesh(
    scene: &Scene,
    simplified: &Simplified,
    reached: &[bool],
    index: &PatchIndex,
    options: &BakeOptions,
    only: Option<&Wanted>,
    tracer: &dyn RayTracer,
) -> SplitMesh {
    let asked = |triangle: u32| only.is_none_or(|only| only.has(scene, triangle as usize));
    let h = simplified.grid.voxel_size as f32;
    if options.patches == PatchSource::Surfels {
        let fragments = &simplified.fragments;
        let lit = |f: usize, side: usize| {
            let patch = fragments.patch[f][side];
            patch != NO_PATCH && reached[patch as usize]
        };
        let wanted =
            |f: usize, side: usize| asked(fragments.triangle[f]) && (lit(f, side) || (side == 0 && !lit(f, 1)));
        return simplify::split_mesh(scene, fragments, h, tracer, wanted);
    }
    let fragments = simplify::clip(scene, &simplified.grid);
    // Wide enough to meet the patch of any point: triangles are larger than faces.
    let patches = &simplified.patches;
    let size = (patches.area.iter().sum::<f32>() / patches.len().max(1) as f32).sqrt() / h;
    let reach = if options.patches == PatchSource::Faces { 1.0 } else { 1.0 + 1.6 * size };
    let cos_threshold = options.normal_threshold.to_radians().cos();
    let lit = |f: usize, side: usize| {
        let t = fragments.triangle[f] as usize;
        let normal = if side == 1 { -scene.normal(t) } else { scene.normal(t) };
        let middle = simplify::clip::point_at(&scene.corners_of(t), simplify::clip::uv_centroid(fragments.uv(f)));
        let mut found = false;
        index.near(middle, reach, |j| {
            let ahead = (simplified.patches.centroid[j] - middle).dot(normal) > -0.01 * h;
            found |= ahead && reached[j] && simplified.patches.normal[j].dot(normal) >= cos_threshold;
        });
        found
    };
    let two_sided = |f: usize| scene.triangles[fragments.triangle[f] as usize].two_sided;
    let wanted = |f: usize, side: usize| {
        asked(fragments.triangle[f])
            && if side == 0 { !two_sided(f) || lit(f, 0) || !lit(f, 1) } else { two_sided(f) && lit(f, 1) }
    };
    let mut mesh = simplify::split_mesh(scene, &fragments, h, tracer, wanted);
    mesh.patch.fill(NO_PATCH);
    mesh
}
