//! The paper's four stages as pictures: direct light, patches, secondary light, and all together.

use glam::Vec3;
use rayon::prelude::*;

use super::{Sight, camera::View, emission, hidden_backs, tonemap::ToneMap};
use crate::{
    Scene,
    bake::Bake,
    light::Crowd,
    progress::Progress,
    scene::{Camera, SurfacePoint},
    trace::{Hit, RayBatch},
};

/// Samples of a pixel: a rotated grid, which smooths edges that are nearly level or upright best.
const SAMPLES: [(f32, f32); 4] = [(0.375, 0.125), (0.875, 0.375), (0.125, 0.625), (0.625, 0.875)];

/// Pixels across and down that are evaluated together.
const TILE: u32 = 32;

/// The pixels of a preview, top row first. Radiance is in W/m2/sr, linear RGB.
#[derive(Clone, Debug, Default)]
pub struct Preview {
    /// Pixels of a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Radiance of lamps and sky, and of what surfaces reflect of direct light.
    pub direct: Vec<Vec3>,
    /// Exitance of the patch that is seen, W/m2; lamps and sky as pi times their radiance.
    pub exitance: Vec<Vec3>,
    /// Radiance of what surfaces reflect of indirect light.
    pub secondary: Vec<Vec3>,
    /// Sum of direct and secondary.
    pub combined: Vec<Vec3>,
    /// Albedo; black where there is no surface.
    pub albedo: Vec<Vec3>,
    /// Shading normal in world axes, on the side that is seen; zero where there is no surface.
    pub normal: Vec<Vec3>,
    /// Distance along the view axis, world units, of the nearest surface in the pixel; infinite where there is none.
    pub depth: Vec<f32>,
    /// Whether a lamp or the sky is in the pixel.
    pub shines: Vec<bool>,
}

impl Preview {
    /// The exposure of all four pictures: [`ToneMap::automatic`] of `combined` without lamps and sky.
    pub fn tone(&self) -> ToneMap {
        let lit = self.combined.iter().zip(&self.shines).filter(|(_, shines)| !**shines);
        ToneMap::automatic(lit.map(|(radiance, _)| *radiance))
    }

    fn black(width: u32, height: u32) -> Preview {
        let n = width as usize * height as usize;
        let colours = || vec![Vec3::ZERO; n];
        Preview {
            width,
            height,
            direct: colours(),
            exitance: colours(),
            secondary: colours(),
            combined: colours(),
            albedo: colours(),
            normal: colours(),
            depth: vec![f32::INFINITY; n],
            shines: vec![false; n],
        }
    }

    /// Writes the pixels of a tile to their places.
    fn put(&mut self, left: u32, top: u32, tile: &[Pixel]) {
        let columns = TILE.min(self.width - left) as usize;
        for (k, p) in tile.iter().enumerate() {
            let at = (top as usize + k / columns) * self.width as usize + left as usize + k % columns;
            self.direct[at] = p.direct;
            self.exitance[at] = p.exitance;
            self.secondary[at] = p.secondary;
            self.combined[at] = p.direct + p.secondary;
            self.albedo[at] = p.albedo;
            self.normal[at] = p.normal;
            self.depth[at] = p.depth;
            self.shines[at] = p.shines;
        }
    }

    /// The exitance as the radiance that a diffuse surface shows, W/m2/sr.
    pub fn exitance_radiance(&self) -> Vec<Vec3> {
        self.exitance.iter().map(|m| *m / std::f32::consts::PI).collect()
    }
}

/// One pixel, summed or finished.
#[derive(Clone, Copy, Default)]
struct Pixel {
    direct: Vec3,
    exitance: Vec3,
    secondary: Vec3,
    albedo: Vec3,
    normal: Vec3,
    depth: f32,
    shines: bool,
}

/// What a sample sees of a surface.
#[derive(Clone, Copy)]
struct Seen {
    pixel: usize,
    point: SurfacePoint,
    albedo: Vec3,
    /// Which of the points to evaluate has its irradiance.
    light: usize,
}

/// Renders `width` x `height` pixels. The same bake and camera give the same bits. What is left when `progress` asks to
/// stop stays black.
pub fn render(
    scene: &Scene,
    bake: &Bake,
    camera: &Camera,
    (width, height): (u32, u32),
    progress: &dyn Progress,
) -> Preview {
    let view = View::new(camera, &scene.frame, width as f32 / height as f32);
    let emission = (0..2 * scene.triangles.len()).map(|face| emission(scene, face / 2, face % 2 == 1)).collect();
    let picture = Picture { scene, bake, view, width, height, emission, crowd: bake.crowd() };
    let (columns, rows) = (width.div_ceil(TILE), height.div_ceil(TILE));
    progress.begin("preview", width as u64 * height as u64);
    let mut preview = Preview::black(width, height);
    let all: Vec<u32> = (0..columns * rows).collect();
    // As many at a time as keep all threads busy: a tile takes as much memory as its part of the preview.
    for some in all.chunks(16 * rayon::current_num_threads()) {
        let tiles: Vec<Vec<Pixel>> = some
            .par_iter()
            .map(|i| {
                let pixels = picture.tile(i % columns * TILE, i / columns * TILE, progress.stopped());
                progress.advance(pixels.len() as u64);
                pixels
            })
            .collect();
        for (i, tile) in some.iter().zip(tiles) {
            preview.put(i % columns * TILE, i / columns * TILE, &tile);
        }
    }
    progress.end();
    preview
}

struct Picture<'a> {
    scene: &'a Scene,
    bake: &'a Bake,
    view: View,
    width: u32,
    height: u32,
    /// By [`Hit::face`].
    emission: Vec<Vec3>,
    /// Very many bright patches.
    crowd: Option<Crowd>,
}

impl Picture<'_> {
    /// The pixels of the tile with top left corner (`left`, `top`), row by row.
    fn tile(&self, left: u32, top: u32, blank: bool) -> Vec<Pixel> {
        let (columns, rows) = (TILE.min(self.width - left), TILE.min(self.height - top));
        let mut rays = RayBatch::with_capacity(SAMPLES.len() * (columns * rows) as usize);
        rays.coherent = true;
        for y in top..top + rows {
            for x in left..left + columns {
                for (dx, dy) in SAMPLES {
                    let (u, v) = ((x as f32 + dx) / self.width as f32, (y as f32 + dy) / self.height as f32);
                    rays.push(self.view.origin, self.view.direction(u, v), 0.0, f32::INFINITY);
                }
            }
        }
        let mut pixels = vec![Pixel { depth: f32::INFINITY, ..Default::default() }; (columns * rows) as usize];
        if blank {
            return pixels;
        }
        self.add_patches(&mut rays.clone(), &mut pixels);
        self.add_surfaces(&mut rays, &mut pixels);
        let share = 1.0 / SAMPLES.len() as f32;
        for p in &mut pixels {
            for sum in [&mut p.direct, &mut p.exitance, &mut p.secondary, &mut p.albedo, &mut p.normal] {
                *sum *= share;
            }
        }
        pixels
    }

    /// Adds what the flat patches show.
    fn add_patches(&self, rays: &mut RayBatch, pixels: &mut [Pixel]) {
        let hidden = |hit: &Hit| self.bake.patch_of(hit).is_none();
        let hits = Sight::new(self.bake.patch_tracer(), &hidden).visible(rays);
        for (i, hit) in hits.iter().enumerate() {
            let exitance = match hit.is_hit().then(|| self.bake.patch_of(hit)).flatten() {
                Some(patch) => self.bake.light.radiosity[patch as usize] + self.bake.patches().emitted[patch as usize],
                None => std::f32::consts::PI * self.bake.sky_radiance(rays.direction(i).normalize()),
            };
            pixels[i / SAMPLES.len()].exitance += exitance;
        }
    }

    /// Adds what the surfaces show.
    fn add_surfaces(&self, rays: &mut RayBatch, pixels: &mut [Pixel]) {
        let hidden = hidden_backs(self.scene);
        let hits = Sight::new(self.bake.tracer(), &hidden).visible(rays);
        let (mut seen, mut points) = (Vec::<Seen>::with_capacity(hits.len()), Vec::new());
        for (i, hit) in hits.iter().enumerate() {
            let pixel = &mut pixels[i / SAMPLES.len()];
            if !hit.is_hit() {
                let sky = self.bake.sky_radiance(rays.direction(i).normalize());
                pixel.direct += sky;
                pixel.shines |= sky != Vec3::ZERO;
                continue;
            }
            let emission = self.emission[hit.face as usize];
            let (point, albedo) = (self.surface_point(hit), self.scene.albedo(hit.triangle(), hit.u, hit.v));
            pixel.direct += emission;
            pixel.shines |= emission != Vec3::ZERO;
            pixel.albedo += albedo;
            pixel.normal += point.normal;
            pixel.depth = pixel.depth.min((hit.t as f64 * self.scene.frame.scale) as f32);
            // Samples of one pixel on one smooth surface share their light; its cost is most of the picture's.
            let width = hit.t * 2.0 * self.view.up.length() / self.height as f32;
            let light = seen
                .iter()
                .rev()
                .take_while(|s| s.pixel == i / SAMPLES.len())
                .find(|s| is_same_surface(&s.point, &point, width))
                .map_or_else(
                    || {
                        points.push(point);
                        points.len() - 1
                    },
                    |s| s.light,
                );
            seen.push(Seen { pixel: i / SAMPLES.len(), point, albedo, light });
        }
        let light = self.bake.seen(&points, self.crowd.as_ref());
        for s in &seen {
            let reflected = s.albedo / std::f32::consts::PI;
            pixels[s.pixel].direct += reflected * light.direct[s.light];
            pixels[s.pixel].secondary += reflected * light.indirect[s.light];
        }
    }

    fn surface_point(&self, hit: &Hit) -> SurfacePoint {
        let t = hit.triangle();
        let mix = |[a, b, c]: [Vec3; 3]| a * (1.0 - hit.u - hit.v) + b * hit.u + c * hit.v;
        let flat = self.scene.normal(t);
        let shading = self.scene.corners.normals.get(t).and_then(|n| mix(*n).try_normalize()).unwrap_or(flat);
        let side = if hit.is_back() { -1.0 } else { 1.0 };
        SurfacePoint { position: mix(self.scene.corners_of(t)), normal: side * shading }
    }
}

/// Whether two points, less than some `width` of a pixel apart, lie on one smooth surface.
fn is_same_surface(a: &SurfacePoint, b: &SurfacePoint, width: f32) -> bool {
    a.normal.dot(b.normal) > 0.95 && a.normal.dot(b.position - a.position).abs() < width
}
