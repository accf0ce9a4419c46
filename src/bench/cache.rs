//! References, kept so that a second run need not compute them again.

use std::{
    fmt::{self, Write as _},
    fs,
    path::Path,
};

use glam::Vec3;
use serde::{Deserialize, Serialize};

use super::{Settings, points};
use crate::{
    Error, Result, Scene,
    colour::luminance,
    output::atomic::Staged,
    progress::{Hushed, Progress},
    reference::{self, ReferenceOptions, Until},
    scene::SurfacePoint,
    trace::RayTracer,
};

/// Light at the points where errors are measured, by path tracing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    position: Vec<[f32; 3]>,
    normal: Vec<[f32; 3]>,
    direct: Vec<[f32; 3]>,
    indirect: Vec<[f32; 3]>,
    // Single precision, which JSON keeps to the last bit.
    total_error: Vec<f32>,
    indirect_error: Vec<f32>,
    /// Paths a point.
    pub samples: u32,
    /// Standard error of the total luminance, root mean square over the points, relative to its mean.
    pub relative_error: f32,
    /// What it took.
    pub seconds: f32,
}

/// Paths a point that tell whether light reaches it: enough for a dark room behind a door.
const PROBE: u32 = 256;
/// Points that are tried for each that is wanted.
const TRIES: usize = 20;

impl Truth {
    /// Of `scene`: from a file in `folder` if there is one for this scene and these settings, else computed and
    /// stored there.
    ///
    /// # Errors
    /// [`Error::Scene`] if hardly any point of the surfaces is lit; those of the path tracer and of writing the file.
    pub fn find(
        scene: &Scene,
        tracer: &dyn RayTracer,
        settings: &Settings,
        folder: &Path,
        progress: &dyn Progress,
    ) -> Result<Truth> {
        let name = format!("reference-{:016x}.json", key(scene, settings));
        // What cannot be read is computed again.
        let stored = fs::read(folder.join(&name)).ok().and_then(|text| serde_json::from_slice(&text).ok());
        if let Some(truth) = stored {
            return Ok(truth);
        }
        let truth = Truth::compute(scene, tracer, settings, progress)?;
        let text = serde_json::to_vec(&truth).map_err(|e| Error::io(folder.join(&name), e.into()))?;
        let mut staged = Staged::open(folder)?;
        staged.write(&name, |out| out.write_all(&text))?;
        staged.commit()?;
        Ok(truth)
    }

    fn compute(scene: &Scene, tracer: &dyn RayTracer, settings: &Settings, progress: &dyn Progress) -> Result<Truth> {
        let points = lit_points(scene, tracer, settings, progress)?;
        let until = Until::StandardError { relative: settings.reference_error, most: settings.most_paths };
        let options = ReferenceOptions { until, seed: settings.seed };
        let found = reference::irradiance(scene, tracer, &points, &options, progress)?;
        let arrays = |values: &[Vec3]| values.iter().map(Vec3::to_array).collect();
        Ok(Truth {
            position: points.iter().map(|p| p.position.to_array()).collect(),
            normal: points.iter().map(|p| p.normal.to_array()).collect(),
            direct: arrays(&found.direct),
            indirect: arrays(&found.indirect),
            total_error: found.luminance_error.iter().map(|&e| e as f32).collect(),
            indirect_error: found.indirect_error.iter().map(|&e| luminance(e) as f32).collect(),
            samples: found.samples,
            relative_error: found.relative_error as f32,
            seconds: found.seconds as f32,
        })
    }

    /// The points.
    pub fn points(&self) -> Vec<SurfacePoint> {
        let point = |(&position, &normal): (&[f32; 3], &[f32; 3])| SurfacePoint {
            position: position.into(),
            normal: normal.into(),
        };
        self.position.iter().zip(&self.normal).map(point).collect()
    }

    /// Standard errors of the luminance of all light, and of indirect light; for the latter an upper bound, the bands
    /// taken as erring alike.
    pub fn noise(&self) -> (Vec<f64>, Vec<f64>) {
        let wide = |errors: &[f32]| errors.iter().map(|&e| e as f64).collect();
        (wide(&self.total_error), wide(&self.indirect_error))
    }

    /// Luminance of all light, and of indirect light.
    pub fn luminance(&self) -> (Vec<f64>, Vec<f64>) {
        let indirect: Vec<f64> = self.indirect.iter().map(|&e| luminance(e.into())).collect();
        let total = self.direct.iter().zip(&indirect).map(|(&d, i)| luminance(d.into()) + i).collect();
        (total, indirect)
    }
}

/// Random points of the surfaces that light reaches: not those hidden inside or behind objects.
fn lit_points(
    scene: &Scene,
    tracer: &dyn RayTracer,
    settings: &Settings,
    progress: &dyn Progress,
) -> Result<Vec<SurfacePoint>> {
    let mut found = Vec::new();
    let mut tried = 0;
    while found.len() < settings.points {
        if tried >= TRIES * settings.points {
            return Err(Error::Scene(format!(
                "scene \"{}\": of {tried} random points of its surfaces light reaches only {}",
                scene.name,
                found.len()
            )));
        }
        let candidates = points::random(scene, tried, settings.points, settings.seed);
        tried += candidates.len();
        let options = ReferenceOptions { until: Until::Samples(PROBE), seed: settings.seed ^ 0x9c };
        let light = reference::irradiance(scene, tracer, &candidates, &options, &Hushed(progress))?;
        let lit = light.direct.iter().zip(&light.indirect).map(|(&d, &i)| luminance(d + i) > 0.0);
        found.extend(candidates.into_iter().zip(lit).filter(|(_, lit)| *lit).map(|(p, _)| p));
    }
    found.truncate(settings.points);
    Ok(found)
}

/// A number that stands for the scene, the points and the settings of the reference.
fn key(scene: &Scene, settings: &Settings) -> u64 {
    let mut key = Fnv(0xcbf2_9ce4_8422_2325);
    let Settings { points, reference_error, most_paths, seed, .. } = settings;
    // All that a scene holds, numbers to their last bit; what it is called is not part of the answer.
    let Scene { frame, positions, triangles, corners, materials, textures, lights, .. } = scene;
    // Writing into a number cannot fail.
    write!(key, "{frame:?}{positions:?}{triangles:?}{corners:?}{materials:?}{textures:?}{lights:?}").ok();
    write!(key, "{points} {reference_error:?} {most_paths} {seed} {}", env!("CARGO_PKG_VERSION")).ok();
    key.0
}

/// FNV-1a, 64 bits (Fowler, Noll & Vo): the same in every build.
struct Fnv(u64);

impl fmt::Write for Fnv {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for &byte in text.as_bytes() {
            self.0 = (self.0 ^ byte as u64).wrapping_mul(0x100_0000_01b3);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::{options::Backend, progress::Silent, selftest::invariants::furnished, trace};

    fn settings() -> Settings {
        Settings { points: 50, reference_error: 0.1, most_paths: 256, ..Settings::default() }
    }

    #[test]
    fn points_lie_where_light_arrives_and_are_found_again() {
        let scene = furnished(false).build().expect("a scene").0;
        let tracer = trace::build(Backend::Auto, &scene.geometry()).expect("a tracer");
        let folder = tempfile::tempdir().expect("a folder");
        let find =
            |settings: &Settings| Truth::find(&scene, &*tracer, settings, folder.path(), &Silent).expect("light");
        let first = find(&settings());
        assert_eq!(first.points().len(), 50);
        let (total, indirect) = first.luminance();
        assert!(total.iter().zip(&indirect).all(|(t, i)| t >= i && *t > 0.0));
        // None under the block, from which no light is seen.
        for p in first.points() {
            let p = scene.frame.to_world(p.position);
            let under = p.z < 1e-3 && (0.2..0.5).contains(&p.x) && (0.3..0.6).contains(&p.y);
            assert!(!under, "{p}");
        }
        // The second comes from the file, to the last bit and with the time of the first.
        assert_eq!(find(&settings()), first);
        assert_eq!(fs::read_dir(folder.path()).expect("files").count(), 1);
        find(&Settings { seed: 1, ..settings() });
        assert_eq!(fs::read_dir(folder.path()).expect("files").count(), 2);
    }

    #[test]
    fn the_key_tells_scenes_and_settings_apart() {
        let scene = |size: f64| {
            let mut world = crate::selftest::World::new();
            let grey = world.grey(0.5, 1.0);
            world.room(DVec3::ZERO, DVec3::new(1.0, 1.0, size), grey);
            world.build().expect("a scene").0
        };
        let one = key(&scene(0.5), &settings());
        assert_eq!(one, key(&scene(0.5), &settings()));
        assert_ne!(one, key(&scene(0.5000001), &settings()));
        assert_ne!(one, key(&scene(0.5), &Settings { points: 51, ..settings() }));
        // Neither times nor repeats are part of the answer.
        assert_eq!(one, key(&scene(0.5), &Settings { repeats: 9, ..settings() }));
    }
}
