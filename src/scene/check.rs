//! What a scene holds, for `luxel check`.

use std::fmt;

use glam::{DVec3, Vec3};
use serde::Serialize;

use super::{Dropped, Light, Scene, SideDecision, SideKind};

/// A summary of a scene, in world units.
#[derive(Clone, Debug, Serialize)]
pub struct SceneCheck {
    /// Name of the scene.
    pub name: String,
    /// Triangles that are left.
    pub triangles: usize,
    /// Vertices that they use.
    pub vertices: usize,
    /// Area of all triangles.
    pub area: f64,
    /// Lowest corner of the bounding box.
    pub low: [f64; 3],
    /// Highest corner of the bounding box.
    pub high: [f64; 3],
    /// Names of the meshes.
    pub meshes: Vec<String>,
    /// Materials that are used.
    pub materials: Vec<MaterialCheck>,
    /// Connected components without a border.
    pub closed_components: usize,
    /// Connected components with a border, or without a common winding.
    pub open_components: usize,
    /// What was decided on their sides.
    pub sides: Vec<SideDecision>,
    /// What was left out.
    pub dropped: Dropped,
    /// The lights, glowing surfaces first.
    pub lights: Vec<String>,
    /// What the reader should know.
    pub warnings: Vec<String>,
}

/// A material and the surfaces that have it.
#[derive(Clone, Debug, Serialize)]
pub struct MaterialCheck {
    /// Its name.
    pub name: String,
    /// Triangles.
    pub triangles: usize,
    /// Area of its triangles.
    pub area: f64,
    /// Mean albedo over its area, textures and vertex colours included (sampled at the triangles' centres).
    pub albedo: [f32; 3],
    /// Largest emitted radiance, W/m2/sr.
    pub emission: [f32; 3],
    /// Emitted power, W.
    pub power: [f64; 3],
}

impl SceneCheck {
    /// Summarises `scene`.
    pub fn new(scene: &Scene) -> SceneCheck {
        let frame = scene.frame;
        let low = scene.positions.iter().fold(Vec3::INFINITY, |m, p| m.min(*p));
        let high = scene.positions.iter().fold(Vec3::NEG_INFINITY, |m, p| m.max(*p));
        let materials = materials(scene);
        let mut lights: Vec<String> = (materials.iter())
            .filter(|m| m.emission != [0.0; 3])
            .map(|m| {
                let [r, g, b] = m.emission;
                let [pr, pg, pb] = m.power;
                format!(
                    "surfaces of \"{}\": {} triangles, area {}, radiance {r} {g} {b} W/m2/sr, power {} {} {} W",
                    m.name,
                    m.triangles,
                    digits(m.area),
                    digits(pr),
                    digits(pg),
                    digits(pb)
                )
            })
            .collect();
        lights.extend(scene.lights.iter().map(|l| describe(l, scene)));
        let is_closed = |d: &&SideDecision| matches!(d.kind, SideKind::Solid | SideKind::Room);
        let closed_components = scene.sides.iter().filter(is_closed).map(|d| d.components).sum();
        let all: usize = scene.sides.iter().map(|d| d.components).sum();
        SceneCheck {
            name: scene.name.clone(),
            triangles: scene.triangles.len(),
            vertices: scene.positions.len(),
            area: materials.iter().map(|m| m.area).sum(),
            low: frame.to_world(low).to_array(),
            high: frame.to_world(high).to_array(),
            meshes: scene.meshes.clone(),
            materials,
            closed_components,
            open_components: all - closed_components,
            sides: scene.sides.clone(),
            dropped: scene.dropped.clone(),
            lights,
            warnings: scene.warnings.clone(),
        }
    }
}

fn materials(scene: &Scene) -> Vec<MaterialCheck> {
    let unit_area = scene.frame.scale * scene.frame.scale;
    let mut sums = vec![(0_usize, 0.0_f64, DVec3::ZERO, Vec3::ZERO, DVec3::ZERO); scene.materials.len()];
    for (t, triangle) in scene.triangles.iter().enumerate() {
        let (n, area, albedo, emission, power) = &mut sums[triangle.material as usize];
        let a = scene.area(t) * unit_area;
        let radiance = scene.emission(t);
        // Exitance is pi times radiance.
        let sides = if triangle.emits_back { 2.0 } else { 1.0 };
        *n += 1;
        *area += a;
        *albedo += a * scene.albedo(t, 1.0 / 3.0, 1.0 / 3.0).as_dvec3();
        *emission = emission.max(radiance);
        *power += sides * std::f64::consts::PI * a * radiance.as_dvec3();
    }
    (scene.materials.iter().zip(sums))
        .filter(|(_, s)| s.0 > 0)
        .map(|(material, (triangles, area, albedo, emission, power))| MaterialCheck {
            name: material.name.clone(),
            triangles,
            area,
            albedo: (albedo / area).as_vec3().to_array(),
            emission: emission.to_array(),
            power: power.to_array(),
        })
        .collect()
}

/// Seven significant digits: what f32 positions are good for, whatever the unit.
fn digits(x: f64) -> String {
    let rounded: f64 = format!("{x:.6e}").parse().unwrap_or(x);
    if rounded != 0.0 && !(1e-4..1e9).contains(&rounded.abs()) { format!("{rounded:e}") } else { rounded.to_string() }
}

fn describe(light: &Light, scene: &Scene) -> String {
    let frame = scene.frame;
    let at = |p: Vec3| {
        let p = frame.to_world(p);
        format!("{} {} {}", digits(p.x), digits(p.y), digits(p.z))
    };
    let rgb = |c: Vec3| format!("{} {} {}", c.x, c.y, c.z);
    let world = |i: Vec3| (i.as_dvec3() * frame.scale * frame.scale).as_vec3();
    match light {
        Light::Rectangle { corner, edge_u, edge_v, radiance } => {
            format!("rectangle around {}, radiance {} W/m2/sr", at(*corner + 0.5 * (*edge_u + *edge_v)), rgb(*radiance))
        }
        Light::Disc { centre, radius, radiance, .. } => format!(
            "disc at {}, radius {}, radiance {} W/m2/sr",
            at(*centre),
            f64::from(*radius) * frame.scale,
            rgb(*radiance)
        ),
        Light::Point { position, intensity, .. } => {
            format!("point at {}, intensity {} W/sr", at(*position), rgb(world(*intensity)))
        }
        Light::Spot { position, intensity, .. } => {
            format!("spot at {}, intensity {} W/sr", at(*position), rgb(world(*intensity)))
        }
        Light::Sun { direction, irradiance } => {
            format!("sun towards {}, irradiance {} W/m2", rgb(*direction), rgb(*irradiance))
        }
        Light::Sky { radiance } => format!("sky, radiance {} W/m2/sr", rgb(*radiance)),
        Light::Environment(e) => format!("environment of {} x {} texels", e.width, e.height),
    }
}

impl fmt::Display for SceneCheck {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ([x0, y0, z0], [x1, y1, z1]) = (self.low.map(digits), self.high.map(digits));
        writeln!(f, "scene {}", self.name)?;
        writeln!(
            f,
            "  {} triangles, {} vertices, {} meshes, area {}",
            self.triangles,
            self.vertices,
            self.meshes.len(),
            digits(self.area)
        )?;
        writeln!(f, "  bounds {x0} {y0} {z0} to {x1} {y1} {z1}")?;
        writeln!(f, "materials")?;
        for m in &self.materials {
            let [r, g, b] = m.albedo;
            writeln!(
                f,
                "  {}: {} triangles, area {}, albedo {r:.4} {g:.4} {b:.4}",
                m.name,
                m.triangles,
                digits(m.area)
            )?;
        }
        writeln!(f, "lights")?;
        if self.lights.is_empty() {
            writeln!(f, "  none; --sky, --sun, --point and --emit add some")?;
        }
        for light in &self.lights {
            writeln!(f, "  {light}")?;
        }
        writeln!(f, "sides: {} closed components, {} open ones", self.closed_components, self.open_components)?;
        for decision in &self.sides {
            writeln!(f, "  {decision}")?;
        }
        let Dropped { short_faces, not_finite, zero_area, duplicate, transparent } = &self.dropped;
        let transparent: usize = transparent.iter().map(|t| t.1).sum();
        writeln!(
            f,
            "left out: {short_faces} faces with fewer than 3 corners, {not_finite} triangles not finite, {zero_area} without \
             area, {duplicate} that coincide with others, {transparent} transparent"
        )?;
        for warning in &self.warnings {
            writeln!(f, "warning: {warning}")?;
        }
        Ok(())
    }
}
