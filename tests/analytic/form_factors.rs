//! Rows of form factors against J. R. Howell's catalogue: C-11 (parallel rectangles), C-14 (perpendicular ones).

use glam::{DVec3, Vec3};
use luxel::{
    BakeOptions,
    bake::Bake,
    options::Primary,
    progress::Silent,
    selftest::{
        closed_forms::{PARALLEL, PERPENDICULAR, parallel, perpendicular},
        form_factors::{parallel_rectangles, perpendicular_rectangles},
        rows,
    },
    transfer::{self, FormFactors},
};

use crate::{
    common::{World, faces, options},
    passes,
};

/// Two rectangles that face each other, "one" and "two".
fn rectangles(corners: [[[f64; 3]; 3]; 2], options: &BakeOptions) -> Rows {
    let mut world = World::new();
    let material = world.grey(0.5, 1.0);
    for (name, [corner, u, v]) in ["one", "two"].into_iter().zip(corners) {
        world.quad(name, corner.into(), u.into(), v.into(), material);
    }
    let stage = world.build();
    let bake = stage.bake(&BakeOptions { primary: Primary::Radiosity, ..options.clone() });
    let all = vec![true; bake.patches().len()];
    let estimate =
        transfer::estimate(&bake.simplified, bake.patch_tracer(), &all, true, options.rays, options.seed, &Silent)
            .expect("nobody interrupts");
    Rows { bake, form_factors: estimate.form_factors, options: options.clone() }
}

struct Rows {
    bake: Bake,
    form_factors: FormFactors,
    options: BakeOptions,
}

impl Rows {
    /// The form factor between two groups of patches, and the standard error that independent rays would have.
    fn between(&self, from: impl Fn(usize) -> bool, to: impl Fn(usize) -> bool) -> (f64, f64) {
        rows::between(self.bake.patches(), &self.form_factors, &self.options, from, to)
    }

    /// Patches that face along `normal`, and the box around their geometry.
    fn facing(&self, normal: Vec3) -> (Vec<bool>, DVec3, DVec3) {
        let patches = self.bake.patches();
        let chosen: Vec<bool> = patches.normal.iter().map(|n| n.dot(normal) > 0.99).collect();
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for i in (0..chosen.len()).filter(|&i| chosen[i]) {
            for m in patches.members(i) {
                let t = self.bake.simplified.fragments.triangle[(m >> 1) as usize] as usize;
                for p in self.bake.simplified.corners(t) {
                    low = low.min(p.as_dvec3());
                    high = high.max(p.as_dvec3());
                }
            }
        }
        (chosen, low, high)
    }
}

/// Sobol points do better than independent rays; 4 sigma of the latter are the limit.
fn check(what: &str, (f, sigma): (f64, f64), expected: f64) {
    let z = (f - expected) / sigma;
    println!("{what}: F = {f:.6}, exact {expected:.6}: {:+.3} % = {z:+.2} sigma", 100.0 * (f / expected - 1.0));
    assert!(z.abs() < 4.0, "{what}: {f}, expected {expected} +- {sigma}");
}

#[test]
fn rows_of_form_factors_agree_with_the_catalogue() {
    passes("form factors");
}

/// Voxel faces of axis-parallel rectangles are rectangles too, larger and moved: the catalogue holds for those.
#[test]
fn voxel_faces_of_parallel_rectangles_exchange_what_the_catalogue_says_of_them() {
    for (abc, _) in &PARALLEL[..5] {
        let rows = rectangles(parallel_rectangles(*abc), &faces(options(20, 1024)));
        let (up, low, high) = rows.facing(Vec3::Z);
        let (down, above, _) = rows.facing(Vec3::NEG_Z);
        let size = high - low;
        let expected = parallel([size.x, size.y, above.z - low.z]);
        check(&format!("voxel faces, parallel {abc:?}"), rows.between(|i| up[i], |j| down[j]), expected);
    }
}

#[test]
fn voxel_faces_of_perpendicular_rectangles_exchange_what_the_catalogue_says_of_them() {
    for (hwl, _) in &PERPENDICULAR[..5] {
        let rows = rectangles(perpendicular_rectangles(*hwl), &faces(options(20, 1024)));
        // The walls' upper edge and the floors' far edge have faces too: only those in the corner's planes count.
        let (up, low, _) = rows.facing(Vec3::Z);
        let (right, left, _) = rows.facing(Vec3::X);
        let patches = rows.bake.patches();
        let half = 0.5 * rows.bake.simplified.grid.voxel_size;
        let floor: Vec<bool> = (0..up.len()).map(|i| up[i] && (patches.centroid[i].z as f64) < low.z + half).collect();
        let wall: Vec<bool> =
            (0..up.len()).map(|i| right[i] && (patches.centroid[i].x as f64) < left.x + half).collect();
        let area = |of: &[bool]| (0..of.len()).filter(|&i| of[i]).map(|i| patches.area[i] as f64).sum::<f64>();
        let depth = rows.facing(Vec3::Z).2.y - low.y;
        let expected = perpendicular([area(&wall) / depth, area(&floor) / depth, depth]);
        check(&format!("voxel faces, perpendicular {hwl:?}"), rows.between(|i| floor[i], |j| wall[j]), expected);
    }
}
