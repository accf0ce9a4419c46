//! The preview's point of view: the scene's camera, or one that shows much of the lit surfaces.

use glam::{DVec3, Vec3};

use super::{Sight, is_back, tonemap::luminance};
use crate::{
    Scene,
    bake::Irradiance,
    sampling,
    scene::{Camera, Frame},
    simplify::SplitMesh,
    trace::{Hit, RayBatch},
};

/// Places in the scene's bounds that are tried as the eye's.
const PLACES: u32 = 128;
/// Rays that look around from a place.
const LOOKS: u32 = 64;
/// Looks of a place that may meet hidden backs: meshes have stray faces.
const STRAY: usize = 3;
/// Median share of the looks from the air that must meet a surface for the scene to count as a room.
const ROOM_SHARE: f32 = 0.75;
/// A room is looked at from outside if its inside shows no more than this share of what its outside does.
const HOLLOW: f32 = 0.05;
/// Compass points that are tried, in a room and around an object.
const COMPASS: u32 = 12;
/// Pitches in a room and elevation around an object, degrees.
const ROOM_PITCHES: [f32; 3] = [0.0, -10.0, -20.0];
const OBJECT_ELEVATION: f32 = 25.0;
/// Vertical angles of view, degrees.
const ROOM_FOV: f64 = 65.0;
const OBJECT_FOV: f64 = 35.0;
/// Rays across and down that judge a view.
const PROBE: (u32, u32) = (12, 9);

/// A pinhole camera in the local frame.
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// The eye.
    pub origin: Vec3,
    /// Unit direction of the view axis.
    pub forward: Vec3,
    /// From the middle of the picture to the middle of its right edge, at distance 1.
    pub right: Vec3,
    /// From the middle of the picture to the middle of its top edge, at distance 1.
    pub up: Vec3,
}

impl View {
    /// `camera` with pictures `aspect` times as wide as high.
    pub fn new(camera: &Camera, frame: &Frame, aspect: f32) -> View {
        let half = (0.5 * camera.vertical_fov.to_radians()).tan() as f32;
        let forward = (camera.target - camera.position).normalize_or(DVec3::NEG_Z).as_vec3();
        let right = forward.cross(camera.up.normalize_or(DVec3::Y).as_vec3());
        // Looking straight up or down: any direction will do for right.
        let right = right.try_normalize().unwrap_or_else(|| sampling::frame(forward).0);
        View {
            origin: frame.to_local(camera.position),
            forward,
            right: right * half * aspect,
            up: right.cross(forward) * half,
        }
    }

    /// Direction through the picture at (`x`, `y`) in [0, 1]^2, from its top left; the part along the axis is 1 long.
    pub fn direction(&self, x: f32, y: f32) -> Vec3 {
        self.forward + (2.0 * x - 1.0) * self.right + (1.0 - 2.0 * y) * self.up
    }
}

/// How bright the surfaces are: one entry a face id of [`crate::trace::Hit`], 0 (black) to 1.
///
/// The mean luminance of the lit faces becomes 1/2, so that a few very bright ones do not decide alone.
pub fn brightness(scene: &Scene, mesh: &SplitMesh, light: &Irradiance) -> Vec<f32> {
    let mut sums = vec![(0.0f32, 0.0f32); 2 * scene.triangles.len()];
    for (i, triangle) in mesh.triangles.iter().enumerate() {
        let [a, b, c] = triangle.map(|v| mesh.positions[v as usize]);
        let area = 0.5 * (b - a).cross(c - a).length();
        let reflected: Vec3 = triangle
            .iter()
            .map(|&v| mesh.albedo[v as usize] * (light.direct[v as usize] + light.indirect[v as usize]))
            .sum::<Vec3>()
            / (3.0 * std::f32::consts::PI);
        let sum = &mut sums[2 * mesh.source[i] as usize + is_back(scene, mesh, i) as usize];
        sum.0 += area * luminance(reflected);
        sum.1 += area;
    }
    let means: Vec<f32> = sums.iter().map(|(light, area)| if *area > 0.0 { light / area } else { 0.0 }).collect();
    let lit = sums
        .iter()
        .filter(|(light, _)| *light > 0.0)
        .fold((0.0f64, 0.0f64), |(light, area), sum| (light + sum.0 as f64, area + sum.1 as f64));
    let mean = (lit.0 / lit.1) as f32;
    means.into_iter().map(|l| if l > 0.0 { l / (l + mean) } else { 0.0 }).collect()
}

/// Chooses a camera: inside a room, else three-quarter from outside with all of the scene in the picture; of the
/// candidates the one that shows the largest area of lit surfaces. Deterministic.
pub fn automatic(scene: &Scene, sight: &Sight, brightness: &[f32], up: DVec3, aspect: f32) -> Camera {
    let (low, high) = bounds(&scene.positions);
    let chooser = Chooser { scene, sight, brightness, up: up.normalize_or(DVec3::Y), aspect, low, high };
    let air = chooser.air();
    let outside = chooser.best(chooser.views_outside());
    let inside = if chooser.is_room(&air) { chooser.best(chooser.views_inside(&air)) } else { None };
    match (inside, outside) {
        // A dark hollow under sunlit ground is not what the scene is about.
        (Some((camera, score)), Some((_, other))) if score > HOLLOW * other => camera,
        (Some((camera, _)), None) | (_, Some((camera, _))) => camera,
        (None, None) => chooser.outside(0),
    }
}

/// A place that is not inside of anything.
struct Air {
    position: Vec3,
    /// Share of looks that meet a surface.
    enclosed: f32,
    /// Distance of the nearest surface that was met.
    clearance: f32,
}

struct Chooser<'a> {
    scene: &'a Scene,
    sight: &'a Sight<'a>,
    brightness: &'a [f32],
    up: DVec3,
    aspect: f32,
    low: Vec3,
    high: Vec3,
}

impl Chooser<'_> {
    fn diagonal(&self) -> f32 {
        (self.high - self.low).length()
    }

    /// The places among the candidates that are not inside of anything.
    fn air(&self) -> Vec<Air> {
        let mut rays = RayBatch::with_capacity((PLACES * LOOKS) as usize);
        for place in 0..PLACES {
            let [x, y, z, _] = sampling::sobol4(place, 0);
            // A little off the bounds: walls stand there.
            let position = self.low + (Vec3::new(x, y, z) * 0.96 + 0.02) * (self.high - self.low);
            for look in 0..LOOKS {
                let [u, v, ..] = sampling::sobol4(look, 1);
                rays.push(position, sphere(u, v), 0.0, f32::INFINITY);
            }
        }
        let hits = self.sight.nearest(&rays);
        let looks = hits.chunks_exact(LOOKS as usize).enumerate();
        looks
            .filter(|(_, hits)| hits.iter().filter(|h| self.sight.is_hidden(h)).count() <= STRAY)
            .map(|(place, hits)| Air {
                position: rays.origin(place * LOOKS as usize),
                enclosed: hits.iter().filter(|h| h.is_hit()).count() as f32 / LOOKS as f32,
                clearance: hits.iter().map(|h| h.t).fold(f32::INFINITY, f32::min),
            })
            .collect()
    }

    fn is_room(&self, air: &[Air]) -> bool {
        let mut shares: Vec<f32> = air.iter().map(|a| a.enclosed).collect();
        let middle = shares.len() / 2;
        !shares.is_empty() && *shares.select_nth_unstable_by(middle, f32::total_cmp).1 >= ROOM_SHARE
    }

    fn views_inside(&self, air: &[Air]) -> Vec<Camera> {
        // Nothing may stand right before the eye; in a scene full of things the roomiest place has to do.
        let roomiest = air.iter().map(|a| a.clearance).fold(0.0, f32::max);
        let clearance = (0.04 * self.diagonal()).min(0.5 * roomiest);
        let places = air.iter().filter(|a| a.clearance >= clearance && a.enclosed >= ROOM_SHARE);
        places
            .flat_map(|a| ROOM_PITCHES.map(|pitch| (a.position, pitch)))
            .flat_map(|(position, pitch)| (0..COMPASS).map(move |i| (position, self.heading(i, pitch))))
            .map(|(position, direction)| Camera {
                position: self.scene.frame.to_world(position),
                target: self.scene.frame.to_world(position + 0.5 * self.diagonal() * direction),
                up: self.up,
                vertical_fov: ROOM_FOV,
            })
            .collect()
    }

    fn views_outside(&self) -> Vec<Camera> {
        (0..COMPASS).map(|i| self.outside(i)).collect()
    }

    /// A view from compass point `i` that just holds the bounds.
    fn outside(&self, i: u32) -> Camera {
        let forward = -self.heading(i, OBJECT_ELEVATION);
        let middle = 0.5 * (self.low + self.high);
        let mut camera = Camera {
            position: self.scene.frame.to_world(middle - forward),
            target: self.scene.frame.to_world(middle),
            up: self.up,
            vertical_fov: OBJECT_FOV,
        };
        let view = View::new(&camera, &self.scene.frame, self.aspect);
        let distance = (0..8)
            .map(|k| {
                let pick = |axis: usize| if k >> axis & 1 == 0 { self.low[axis] } else { self.high[axis] };
                let corner = Vec3::new(pick(0), pick(1), pick(2)) - middle;
                let across = corner.dot(view.right).abs() / view.right.length_squared();
                let along = corner.dot(view.up).abs() / view.up.length_squared();
                across.max(along) - corner.dot(view.forward)
            })
            .fold(0.0, f32::max);
        camera.position = self.scene.frame.to_world(middle - 1.05 * distance * forward);
        camera
    }

    /// Unit direction towards compass point `i`, `pitch` degrees above the horizon.
    fn heading(&self, i: u32, pitch: f32) -> Vec3 {
        let up = self.up.as_vec3();
        let (east, north) = sampling::frame(up);
        // Off the axes, so that walls and boxes are not seen square on.
        let (sin, cos) = ((i as f32 + 0.4) / COMPASS as f32 * std::f32::consts::TAU).sin_cos();
        let (rise, level) = pitch.to_radians().sin_cos();
        level * (cos * east + sin * north) + rise * up
    }

    /// The view with the highest score, and that; `None` if no view sees any light.
    fn best(&self, views: Vec<Camera>) -> Option<(Camera, f32)> {
        let scored = views.into_iter().map(|c| (c, self.score(&c))).filter(|(_, score)| *score > 0.0);
        // The first of equals.
        scored.reduce(|best, next| if next.1 > best.1 { next } else { best })
    }

    /// The area of surfaces in the picture, weighted by brightness; local units. What stands behind hidden backs does
    /// not count, though a picture would show it.
    fn score(&self, camera: &Camera) -> f32 {
        let view = View::new(camera, &self.scene.frame, self.aspect);
        let (columns, rows) = PROBE;
        let mut rays = RayBatch::with_capacity((columns * rows) as usize);
        for y in 0..rows {
            for x in 0..columns {
                let (x, y) = ((x as f32 + 0.5) / columns as f32, (y as f32 + 0.5) / rows as f32);
                rays.push(view.origin, view.direction(x, y), 0.0, f32::INFINITY);
            }
        }
        let pixel = 4.0 * view.right.length() * view.up.length() / (columns * rows) as f32;
        let seen = self.sight.nearest(&rays);
        let area = |(i, hit): (usize, &Hit)| {
            // A pixel's area, scaled from distance 1 to the surface's and turned into its plane; what is seen at a
            // grazing angle is not seen well.
            let direction = rays.direction(i).normalize();
            let slant = direction.dot(self.scene.normal(hit.triangle())).abs().max(0.25);
            let area = pixel * hit.t * hit.t * direction.dot(view.forward) / slant;
            area * self.brightness.get(hit.face as usize).copied().unwrap_or(0.0)
        };
        seen.iter().enumerate().filter(|(_, hit)| hit.is_hit() && !self.sight.is_hidden(hit)).map(area).sum()
    }
}

/// Uniform direction.
fn sphere(u: f32, v: f32) -> Vec3 {
    let z = 1.0 - 2.0 * u;
    let (sin, cos) = (v * std::f32::consts::TAU).sin_cos();
    let r = (1.0 - z * z).max(0.0).sqrt();
    Vec3::new(r * cos, r * sin, z)
}

fn bounds(positions: &[Vec3]) -> (Vec3, Vec3) {
    let fold = |f: fn(Vec3, Vec3) -> Vec3| positions.iter().copied().reduce(f).unwrap_or_default();
    (fold(Vec3::min), fold(Vec3::max))
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: Frame = Frame { origin: DVec3::new(1.0, 2.0, 3.0), scale: 4.0 };

    #[test]
    fn a_view_spans_its_angle_with_right_to_the_right_and_up_at_the_top() {
        let position = DVec3::new(1.0, 2.0, 7.0);
        let camera = Camera { position, target: FRAME.origin, up: DVec3::Y, vertical_fov: 90.0 };
        let view = View::new(&camera, &FRAME, 2.0);
        assert_eq!(view.origin, Vec3::Z);
        let near = |a: Vec3, b: Vec3| assert!((a - b).length() < 1e-6, "{a} is not {b}");
        near(view.direction(0.5, 0.5), Vec3::NEG_Z);
        // tan 45 degrees = 1 upwards, twice that sideways.
        near(view.direction(0.0, 0.0), Vec3::new(-2.0, 1.0, -1.0));
        near(view.direction(1.0, 1.0), Vec3::new(2.0, -1.0, -1.0));
    }

    #[test]
    fn looking_straight_down_has_a_finite_view() {
        let position = DVec3::new(1.0, 6.0, 3.0);
        let camera = Camera { position, target: FRAME.origin, up: DVec3::Y, vertical_fov: 40.0 };
        let view = View::new(&camera, &FRAME, 1.0);
        assert!(view.right.is_finite() && view.up.is_finite());
        assert!(view.right.dot(view.forward).abs() < 1e-6 && view.right.length() > 0.3);
    }
}
