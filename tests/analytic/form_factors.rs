//! Rows of form factors against J. R. Howell's catalogue: C-11 (parallel rectangles), C-14 (perpendicular ones).

use std::f64::consts::PI;

use glam::{DVec3, Vec3};
use luxel::{
    BakeOptions,
    bake::Bake,
    options::Primary,
    progress::Silent,
    transfer::{self, FormFactors},
};

use crate::common::{World, faces, mesh_of, options};

/// a x b rectangles at distance c.
fn parallel([a, b, c]: [f64; 3]) -> f64 {
    let (x, y) = (a / c, b / c);
    let (x1, y1) = (1.0 + x * x, 1.0 + y * y);
    let logarithm = 0.5 * (x1 * y1 / (x1 + y * y)).ln();
    2.0 / (PI * x * y)
        * (logarithm + x * y1.sqrt() * (x / y1.sqrt()).atan() + y * x1.sqrt() * (y / x1.sqrt()).atan()
            - x * x.atan()
            - y * y.atan())
}

/// From a w x l rectangle to an h x l one that stands on its edge l.
fn perpendicular([h, w, l]: [f64; 3]) -> f64 {
    let (h, w) = (h / l, w / l);
    let (hh, ww) = (h * h, w * w);
    let ss = hh + ww;
    let s = ss.sqrt();
    let logarithm = ((1.0 + ww) * (1.0 + hh) / (1.0 + ss)).ln()
        + ww * (ww * (1.0 + ss) / ((1.0 + ww) * ss)).ln()
        + hh * (hh * (1.0 + ss) / ((1.0 + hh) * ss)).ln();
    (w * (1.0 / w).atan() + h * (1.0 / h).atan() - s * (1.0 / s).atan() + 0.25 * logarithm) / (PI * w)
}

const PARALLEL: [([f64; 3], f64); 6] = [
    ([1.0, 1.0, 1.0], 0.199824896),
    ([1.0, 1.0, 0.1], 0.826994522),
    ([1.0, 1.0, 0.5], 0.415253284),
    ([1.0, 1.0, 2.0], 0.068589589),
    ([1.0, 2.0, 1.0], 0.285875385),
    ([1.0, 1.0, 10.0], 0.003162057),
];

const PERPENDICULAR: [([f64; 3], f64); 6] = [
    ([1.0, 1.0, 1.0], 0.200043776),
    ([1.0, 2.0, 1.0], 0.116426301),
    ([2.0, 1.0, 1.0], 0.232852603),
    ([0.5, 1.0, 1.0], 0.146186679),
    ([0.1, 1.0, 1.0], 0.043251369),
    ([10.0, 1.0, 1.0], 0.249209486),
];

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
        transfer::estimate(&bake.simplified, bake.patch_tracer(), &all, true, options.rays, options.seed, &Silent);
    let rays = options.rays as f64;
    let one = (0..all.len())
        .map(|i| options.patches == luxel::options::PatchSource::Surfels && mesh_of(&stage.scene, &bake, i) == "one")
        .collect();
    Rows { bake, form_factors: estimate.form_factors, rays, one }
}

struct Rows {
    bake: Bake,
    form_factors: FormFactors,
    rays: f64,
    /// Whether a patch belongs to the first rectangle; for patches of surface.
    one: Vec<bool>,
}

impl Rows {
    /// The form factor between two groups of patches, and the standard error that independent rays would have.
    fn between(&self, from: impl Fn(usize) -> bool, to: impl Fn(usize) -> bool) -> (f64, f64) {
        let (mut area, mut sum, mut variance) = (0.0, 0.0, 0.0);
        for i in (0..self.form_factors.len()).filter(|&i| from(i)) {
            let f: f64 = self.form_factors.row(i).filter(|&(j, _)| to(j)).map(|(_, f)| f).sum();
            let a = self.bake.patches().area[i] as f64;
            area += a;
            sum += a * f;
            variance += a * a * f * (1.0 - f) / self.rays;
        }
        (sum / area, variance.sqrt() / area)
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
fn closed_forms_give_the_values_of_the_catalogue() {
    for (abc, expected) in PARALLEL {
        assert!((parallel(abc) - expected).abs() < 1e-9, "{abc:?}: {}", parallel(abc));
    }
    for (hwl, expected) in PERPENDICULAR {
        assert!((perpendicular(hwl) - expected).abs() < 1e-9, "{hwl:?}: {}", perpendicular(hwl));
    }
}

#[test]
fn parallel_rectangles_exchange_what_the_catalogue_says() {
    for (abc @ [a, b, c], expected) in PARALLEL {
        let floor = [[0.0; 3], [a, 0.0, 0.0], [0.0, b, 0.0]];
        let ceiling = [[0.0, 0.0, c], [0.0, b, 0.0], [a, 0.0, 0.0]];
        let rows = rectangles([floor, ceiling], &options(12, 1024));
        check(&format!("parallel {abc:?}"), rows.between(|i| rows.one[i], |j| !rows.one[j]), expected);
        check(&format!("parallel {abc:?} back"), rows.between(|i| !rows.one[i], |j| rows.one[j]), expected);
    }
}

#[test]
fn perpendicular_rectangles_exchange_what_the_catalogue_says() {
    for (hwl @ [h, w, l], expected) in PERPENDICULAR {
        let floor = [[0.0; 3], [w, 0.0, 0.0], [0.0, l, 0.0]];
        let wall = [[0.0; 3], [0.0, l, 0.0], [0.0, 0.0, h]];
        let rows = rectangles([floor, wall], &options(12, 1024));
        check(&format!("perpendicular {hwl:?}"), rows.between(|i| rows.one[i], |j| !rows.one[j]), expected);
        let back = rows.between(|i| !rows.one[i], |j| rows.one[j]);
        check(&format!("perpendicular {hwl:?} back"), back, expected * w / h);
    }
}

/// Voxel faces of axis-parallel rectangles are rectangles too, larger and moved: the catalogue holds for those.
#[test]
fn voxel_faces_of_parallel_rectangles_exchange_what_the_catalogue_says_of_them() {
    for (abc @ [a, b, c], _) in &PARALLEL[..5] {
        let floor = [[0.0; 3], [*a, 0.0, 0.0], [0.0, *b, 0.0]];
        let ceiling = [[0.0, 0.0, *c], [0.0, *b, 0.0], [*a, 0.0, 0.0]];
        let rows = rectangles([floor, ceiling], &faces(options(20, 1024)));
        let (up, low, high) = rows.facing(Vec3::Z);
        let (down, above, _) = rows.facing(Vec3::NEG_Z);
        let size = high - low;
        let expected = parallel([size.x, size.y, above.z - low.z]);
        check(&format!("voxel faces, parallel {abc:?}"), rows.between(|i| up[i], |j| down[j]), expected);
    }
}

#[test]
fn voxel_faces_of_perpendicular_rectangles_exchange_what_the_catalogue_says_of_them() {
    for (hwl @ [h, w, l], _) in &PERPENDICULAR[..5] {
        let floor = [[0.0; 3], [*w, 0.0, 0.0], [0.0, *l, 0.0]];
        let wall = [[0.0; 3], [0.0, *l, 0.0], [0.0, 0.0, *h]];
        let rows = rectangles([floor, wall], &faces(options(20, 1024)));
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
