//! Scenes with known answers, and what is asked of their bakes.
#![allow(dead_code)] // Each test binary uses a part.

use std::f64::consts::PI;

use glam::{DAffine3, DQuat, DVec3, Vec3};
use luxel::{
    BakeOptions, Scene,
    bake::Bake,
    options::{PatchSource, Resolution},
    scene::{Builder, Material, RawMaterial, RawMesh, SidesRule, SurfacePoint, WorldLight},
};

/// A scene under construction.
pub struct World {
    pub builder: Builder,
    turned: DAffine3,
}

impl World {
    pub fn new() -> World {
        World { builder: Builder::new("test"), turned: DAffine3::IDENTITY }
    }

    /// A grey material.
    pub fn grey(&mut self, albedo: f32, emission: f32) -> u32 {
        let surface = Material {
            name: "grey".into(),
            albedo: Vec3::splat(albedo),
            emission: Vec3::splat(emission),
            ..Material::default()
        };
        self.builder.add_material(RawMaterial { surface, ..RawMaterial::default() })
    }

    pub fn mesh(&mut self, name: &str, positions: Vec<DVec3>, triangles: Vec<[u32; 3]>, material: u32) {
        self.builder.add_mesh(RawMesh { name: name.into(), positions, triangles, material, ..RawMesh::default() });
    }

    /// The front is on the side of u x v.
    pub fn quad(&mut self, name: &str, corner: DVec3, u: DVec3, v: DVec3, material: u32) {
        let positions = vec![corner, corner + u, corner + u + v, corner + v];
        self.mesh(name, positions, vec![[0, 1, 2], [0, 2, 3]], material);
    }

    /// The walls of a box, seen from inside; one mesh.
    pub fn room(&mut self, low: DVec3, high: DVec3, material: u32) {
        self.named_room("room", low, high, material);
    }

    pub fn named_room(&mut self, name: &str, low: DVec3, high: DVec3, material: u32) {
        let size = high - low;
        for axis in 0..3 {
            let (u, v) = (DVec3::AXES[(axis + 1) % 3] * size, DVec3::AXES[(axis + 2) % 3] * size);
            self.quad(name, low, u, v, material);
            self.quad(name, low + DVec3::AXES[axis] * size, v, u, material);
        }
    }

    /// A box seen from outside.
    pub fn block(&mut self, low: DVec3, high: DVec3, material: u32) {
        let size = high - low;
        for axis in 0..3 {
            let (u, v) = (DVec3::AXES[(axis + 1) % 3] * size, DVec3::AXES[(axis + 2) % 3] * size);
            self.quad("block", low, v, u, material);
            self.quad("block", low + DVec3::AXES[axis] * size, u, v, material);
        }
    }

    /// An icosahedron, its triangles split in four `levels` times, with all vertices on the sphere; seen from inside.
    pub fn sphere(&mut self, centre: DVec3, radius: f64, levels: u32, material: u32) {
        let (mut positions, mut triangles) = icosahedron();
        for _ in 0..levels {
            let mut middles = std::collections::HashMap::new();
            triangles = (triangles.iter())
                .flat_map(|&[a, b, c]| {
                    let mut middle = |a: u32, b: u32| {
                        *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                            positions.push((positions[a as usize] + positions[b as usize]).normalize());
                            positions.len() as u32 - 1
                        })
                    };
                    let (x, y, z) = (middle(a, b), middle(b, c), middle(c, a));
                    [[a, x, z], [b, y, x], [c, z, y], [x, y, z]]
                })
                .collect();
        }
        positions.iter_mut().for_each(|p| *p = centre + radius * *p);
        self.mesh("sphere", positions, triangles.iter().map(|&[a, b, c]| [a, c, b]).collect(), material);
    }

    pub fn point_light(&mut self, position: DVec3, flux: f64) {
        let intensity = Vec3::splat((flux / (4.0 * PI)) as f32);
        self.builder.add_light(WorldLight::Point { position, intensity, range: f64::INFINITY });
    }

    /// Moves everything that is there so far.
    pub fn transform(&mut self, transform: DAffine3) {
        let everything = Builder::new("").mark();
        self.builder.transform_since(everything, &transform);
        self.turned = transform * self.turned;
    }

    /// The scene, one-sided as wound, and the map from the coordinates it was built in to the local frame.
    pub fn build(self) -> Stage {
        self.build_by(SidesRule::One)
    }

    /// As [`World::build`], with another rule for sides.
    pub fn build_by(self, rule: SidesRule) -> Stage {
        let scene = self.builder.build(rule).expect("a valid scene");
        Stage { scene, turned: self.turned }
    }
}

/// A scene and where its own coordinates went.
pub struct Stage {
    pub scene: Scene,
    turned: DAffine3,
}

impl Stage {
    /// Surface point in the coordinates that the scene was built in.
    pub fn point(&self, position: [f64; 3], normal: [f64; 3]) -> SurfacePoint {
        SurfacePoint {
            position: self.scene.frame.to_local(self.turned.transform_point3(position.into())),
            normal: self.turned.transform_vector3(normal.into()).normalize().as_vec3(),
        }
    }

    /// Where a local point lies in the coordinates that the scene was built in.
    pub fn as_built(&self, local: Vec3) -> DVec3 {
        self.turned.inverse().transform_point3(self.scene.frame.to_world(local))
    }

    pub fn bake(&self, options: &BakeOptions) -> Bake {
        luxel::bake(&self.scene, options, &luxel::progress::Silent).expect("a bake")
    }

    /// Area of the surfaces, world units.
    pub fn area(&self) -> f64 {
        (0..self.scene.triangles.len()).map(|t| self.scene.area(t)).sum::<f64>() * self.scene.frame.scale.powi(2)
    }
}

fn icosahedron() -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let g = (1.0 + 5.0_f64.sqrt()) / 2.0;
    let mut positions = Vec::new();
    for s in [1.0, -1.0] {
        for t in [g, -g] {
            positions.extend([DVec3::new(0.0, s, t), DVec3::new(s, t, 0.0), DVec3::new(t, 0.0, s)]);
        }
    }
    // Faces are the triples of vertices at the edge length, 2.
    let near = |a: usize, b: usize| (positions[a].distance(positions[b]) - 2.0).abs() < 1e-9;
    let mut triangles = Vec::new();
    for a in 0..12 {
        for b in a + 1..12 {
            for c in b + 1..12 {
                if near(a, b) && near(b, c) && near(c, a) {
                    let (p, q, r) = (positions[a], positions[b], positions[c]);
                    let outward = (q - p).cross(r - p).dot(p) > 0.0;
                    triangles.push(if outward { [a, b, c] } else { [a, c, b] }.map(|v| v as u32));
                }
            }
        }
    }
    assert_eq!(triangles.len(), 20);
    (positions.iter().map(|p| p.normalize()).collect(), triangles)
}

/// A rotation about no axis of symmetry.
pub fn rotation() -> DAffine3 {
    DAffine3::from_quat(DQuat::from_axis_angle(DVec3::new(0.48, 0.6, 0.64), 0.9))
}

pub fn options(grid: u32, rays: u32) -> BakeOptions {
    BakeOptions { resolution: Resolution::Grid(grid), rays, estimate: false, ..BakeOptions::default() }
}

pub fn faces(options: BakeOptions) -> BakeOptions {
    BakeOptions { patches: PatchSource::Faces, ..options }
}

/// Mean of a value of the patches, by area.
pub fn patch_mean(bake: &Bake, values: &[Vec3]) -> f64 {
    let (mut sum, mut area) = (0.0, 0.0);
    for (&a, v) in bake.patches().area.iter().zip(values) {
        sum += a as f64 * v.x as f64;
        area += a as f64;
    }
    sum / area
}

/// Mean of a value of the vertices over the surface of the split mesh, by area.
pub fn vertex_mean(bake: &Bake, values: &[Vec3]) -> f64 {
    let (mut sum, mut area) = (0.0, 0.0);
    for t in &bake.mesh.triangles {
        let [a, b, c] = t.map(|v| bake.mesh.positions[v as usize].as_dvec3());
        let own = (b - a).cross(c - a).length();
        sum += own * t.iter().map(|&v| values[v as usize].x as f64).sum::<f64>() / 3.0;
        area += own;
    }
    sum / area
}

/// The name of the mesh that a patch of surface belongs to.
pub fn mesh_of<'a>(scene: &'a Scene, bake: &Bake, patch: usize) -> &'a str {
    let fragment = bake.patches().members(patch)[0] >> 1;
    let triangle = bake.simplified.fragments.triangle[fragment as usize] as usize;
    &scene.meshes[scene.triangles[triangle].mesh as usize]
}

/// The irradiance of the first channel.
pub fn red(values: &[Vec3]) -> Vec<f64> {
    values.iter().map(|v| v.x as f64).collect()
}

/// Largest relative error.
pub fn worst(got: &[f64], expected: &[f64]) -> f64 {
    assert_eq!(got.len(), expected.len());
    got.iter().zip(expected).map(|(g, e)| (g / e - 1.0).abs()).fold(0.0, f64::max)
}
