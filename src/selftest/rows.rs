//! Rows of form factors summed up over groups of patches.

use glam::{DVec3, Vec3};

use crate::{BakeOptions, Scene, bake::Bake, simplify::Patches, transfer::FormFactors};

/// The name of the mesh that a patch of surface belongs to.
pub fn mesh_of<'a>(scene: &'a Scene, bake: &Bake, patch: usize) -> &'a str {
    let fragment = bake.patches().members(patch)[0] >> 1;
    let triangle = bake.simplified.fragments.triangle[fragment as usize] as usize;
    &scene.meshes[scene.triangles[triangle].mesh as usize]
}

/// Area of a patch that does not lie hidden inside or behind objects, local units squared.
pub fn visible_area(patches: &Patches, form_factors: &FormFactors, i: usize) -> f64 {
    patches.area[i] as f64 * (1.0 - form_factors.hidden(i))
}

/// The form factor between two groups of patches, and the standard error that independent rays would have: that of row i is
/// sqrt(F (1 - F) / rays).
pub fn between(
    patches: &Patches,
    form_factors: &FormFactors,
    options: &BakeOptions,
    from: impl Fn(usize) -> bool,
    to: impl Fn(usize) -> bool,
) -> (f64, f64) {
    let (mut area, mut sum, mut variance) = (0.0, 0.0, 0.0);
    for i in (0..form_factors.len()).filter(|&i| from(i)) {
        let f: f64 = form_factors.row(i).filter(|&(j, _)| to(j)).map(|(_, f)| f).sum();
        let a = visible_area(patches, form_factors, i);
        area += a;
        sum += a * f;
        variance += a * a * f * (1.0 - f) / options.rays as f64;
    }
    (sum / area, variance.sqrt() / area)
}

/// Mean of a value of the patches, by area.
pub fn patch_mean(bake: &Bake, values: &[Vec3]) -> DVec3 {
    let (mut sum, mut area) = (DVec3::ZERO, 0.0);
    for (&a, v) in bake.patches().area.iter().zip(values) {
        sum += a as f64 * v.as_dvec3();
        area += a as f64;
    }
    sum / area
}
