//! `luxel relight --orbit`: pictures of a light that goes round.

use glam::DVec3;
use luxel::{
    Error, Relighter, Result, Scene,
    bake::Bake,
    output::{
        atomic::Staged,
        exr::{self, Compression},
        layers, png, preview,
        tonemap::ToneMap,
    },
    progress::{self, Progress, Silent},
    relight::{middle, orbit, outward},
    transfer::Rows,
};

use super::{parse, results::Results};

#[derive(clap::Args, Debug)]
#[command(next_help_heading = "Orbit")]
pub struct Orbit {
    /// Write N pictures of a light that goes once round the vertical axis, orbit-0000.png and .exr and so on, in place
    /// of all other files
    #[arg(long, value_name = "N", value_parser = parse::count)]
    orbit: Option<usize>,
    /// The light that goes round: its number, from 0 as the scene has them, or the name of an emitting material
    /// [default: the first]
    #[arg(long, value_name = "LIGHT", requires = "orbit")]
    orbit_light: Option<String>,
    /// A point of the axis [default: the middle of the scene]
    #[arg(long, value_name = "X,Y,Z", value_parser = parse::place, allow_hyphen_values = true, requires = "orbit")]
    orbit_centre: Option<DVec3>,
    /// Radius of the circle [default: the light's distance from the axis, at least a quarter of the scene's narrower side]
    #[arg(long, value_name = "LENGTH", value_parser = parse::positive, allow_hyphen_values = true, requires = "orbit")]
    orbit_radius: Option<f64>,
}

impl Orbit {
    /// Pictures to make; `None` if there shall be no orbit.
    pub fn frames(&self) -> Option<usize> {
        self.orbit
    }

    /// Lights `frames` pictures of the bake of `scene`, whose rows are all in `rows`, and writes them with one exposure. The
    /// bake is lost.
    ///
    /// # Errors
    /// [`Error::Option`] for a light that is not there; those of [`Relighter::with_rows`] and of writing.
    pub fn write(
        &self,
        frames: usize,
        (scene, bake, rows): (&Scene, Bake, &Rows),
        results: &Results,
        mut staged: Staged,
        progress: &dyn Progress,
    ) -> Result<()> {
        let camera = results.picture.camera(scene, &bake);
        let mut relighter = Relighter::with_rows(scene.clone(), bake, rows)?;
        let light = self.light(&relighter)?;
        let centre = self.orbit_centre.unwrap_or_else(|| middle(scene));
        let out = outward(scene, &relighter.sources()[light], [centre, camera.up], self.orbit_radius);
        let mut tone = results.picture.exposure.map(|exposure| ToneMap { exposure });
        progress.begin("orbit", frames as u64);
        for (k, place) in orbit(centre, camera.up, out, frames).enumerate() {
            progress::go_on(progress, "orbit")?;
            relighter.place(light, place)?;
            relighter.bake();
            let (scene, bake) = relighter.lit();
            let pixels = preview::render(scene, bake, &camera, results.picture.preview_size, &Silent);
            let tone = *tone.get_or_insert_with(|| pixels.tone());
            let combined = &pixels.combined;
            staged.write(&format!("orbit-{k:04}.png"), |out| {
                png::write(out, pixels.width, pixels.height, combined, tone)
            })?;
            staged.write_path(&format!("orbit-{k:04}.exr"), |path| {
                exr::write(path, &layers::image(&pixels, &bake.report), Compression::Zip)
            })?;
            progress.advance(1);
        }
        progress.end();
        staged.commit().map(drop)
    }

    fn light(&self, relighter: &Relighter) -> Result<usize> {
        let sources = relighter.sources();
        let names: Vec<&str> = sources.iter().map(|s| s.name()).collect();
        let Some(asked) = &self.orbit_light else {
            return if names.is_empty() { Err(Error::Option("there is no light to go round".into())) } else { Ok(0) };
        };
        let of_material = |name: &str| name == format!("material \"{asked}\"");
        let found = names.iter().position(|name| of_material(name));
        let number = asked.parse().ok().filter(|n| *n < names.len());
        found.or(number).ok_or_else(|| {
            Error::Option(format!(
                "there is no light \"{asked}\" to go round; there are 0 to {}: {}",
                names.len().max(1) - 1,
                names.join(", ")
            ))
        })
    }
}
