//! Scenes with known answers, built in memory.

use std::{collections::HashMap, f64::consts::PI};

use glam::{DAffine3, DQuat, DVec3, Vec3};

use crate::{
    Result, Scene,
    scene::{Builder, Material, RawMaterial, RawMesh, SidesRule, SurfacePoint, WorldLight},
};

/// A scene under construction, of rectangles, boxes and spheres that are seen from one side.
#[derive(Default)]
pub struct World {
    /// What is there so far.
    pub builder: Builder,
    turned: DAffine3,
}

impl World {
    /// Nothing.
    pub fn new() -> World {
        World { builder: Builder::new("test"), turned: DAffine3::IDENTITY }
    }

    /// A grey material; the emission is radiance, W/m2/sr.
    pub fn grey(&mut self, albedo: f32, emission: f32) -> u32 {
        self.coloured(Vec3::splat(albedo), emission)
    }

    /// A material with an albedo of its own in every channel: three scenes in one bake.
    pub fn coloured(&mut self, albedo: Vec3, emission: f32) -> u32 {
        let surface = Material { name: "grey".into(), albedo, emission: Vec3::splat(emission), ..Material::default() };
        self.builder.add_material(RawMaterial { surface, ..RawMaterial::default() })
    }

    /// A mesh.
    pub fn mesh(&mut self, name: &str, positions: Vec<DVec3>, triangles: Vec<[u32; 3]>, material: u32) {
        self.builder.add_mesh(RawMesh { name: name.into(), positions, triangles, material, ..RawMesh::default() });
    }

    /// A parallelogram; its front is on the side of u x v.
    pub fn quad(&mut self, name: &str, corner: DVec3, u: DVec3, v: DVec3, material: u32) {
        let positions = vec![corner, corner + u, corner + u + v, corner + v];
        self.mesh(name, positions, vec![[0, 1, 2], [0, 2, 3]], material);
    }

    /// The walls of a box, seen from inside; one mesh, called "room".
    pub fn room(&mut self, low: DVec3, high: DVec3, material: u32) {
        self.named_room("room", low, high, material);
    }

    /// As [`World::room`], with another name.
    pub fn named_room(&mut self, name: &str, low: DVec3, high: DVec3, material: u32) {
        let size = high - low;
        for axis in 0..3 {
            let (u, v) = (DVec3::AXES[(axis + 1) % 3] * size, DVec3::AXES[(axis + 2) % 3] * size);
            self.quad(name, low, u, v, material);
            self.quad(name, low + DVec3::AXES[axis] * size, v, u, material);
        }
    }

    /// A box seen from outside, called "block".
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
            let mut middles = HashMap::new();
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

    /// An isotropic point light of `flux` W.
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

    /// The scene, one-sided as wound, and the way from the coordinates it was built in to its own.
    ///
    /// # Errors
    /// Those of [`Builder::build`].
    pub fn build(self) -> Result<(Scene, Placement)> {
        self.build_by(SidesRule::One)
    }

    /// As [`World::build`], with another rule for sides.
    ///
    /// # Errors
    /// Those of [`Builder::build`].
    pub fn build_by(self, rule: SidesRule) -> Result<(Scene, Placement)> {
        Ok((self.builder.build(rule)?, Placement(self.turned)))
    }
}

/// Where the coordinates that a scene was built in went.
#[derive(Clone, Copy)]
pub struct Placement(DAffine3);

impl Placement {
    /// Surface point of `scene` in the coordinates that it was built in.
    pub fn point(&self, scene: &Scene, position: [f64; 3], normal: [f64; 3]) -> SurfacePoint {
        SurfacePoint {
            position: scene.frame.to_local(self.0.transform_point3(position.into())),
            normal: self.0.transform_vector3(normal.into()).normalize().as_vec3(),
        }
    }

    /// Where a local point of `scene` lies in the coordinates that it was built in.
    pub fn as_built(&self, scene: &Scene, local: Vec3) -> DVec3 {
        self.0.inverse().transform_point3(scene.frame.to_world(local))
    }
}

/// A rotation about no axis of symmetry.
pub fn rotation() -> DAffine3 {
    DAffine3::from_quat(DQuat::from_axis_angle(DVec3::new(0.48, 0.6, 0.64), 0.9))
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
    debug_assert_eq!(triangles.len(), 20);
    (positions.iter().map(|p| p.normalize()).collect(), triangles)
}
