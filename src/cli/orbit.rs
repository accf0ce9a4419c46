//! `luxel relight --orbit`: pictures of a light that goes round.

use glam::DVec3;
use luxel::{
    BakeOptions, Error, Relighter, Result, Scene,
    bake::Bake,
    output::{
        atomic::Staged,
        exr::{self, Compression},
        layers, png, preview,
        tonemap::ToneMap,
    },
    progress::{self, Progress, Silent},
    relight::{Source, middle, orbit, outward, sources},
    scene::WorldLight,
    transfer::Rows,
};

use super::{parse, results::Results};

#[derive(clap::Args, Debug)]
#[command(next_help_heading = "Orbit")]
pub struct Orbit {
    /// Write N pictures of a light that goes once round the vertical axis, orbit-0000.png and .exr and so on, in place
    /// of all other files
    #[arg(long, value_name = "N", value_parser = parse::count, conflicts_with = "no_preview")]
    orbit: Option<usize>,
    /// The light that goes round: its number, from 0 as the scene has them, or the name of an emitting material
    /// [default: the first that is no sky]
    #[arg(long, value_name = "LIGHT", requires = "orbit")]
    orbit_light: Option<String>,
    /// A point of the axis [default: the middle of the scene]
    #[arg(long, value_name = "X,Y,Z", value_parser = parse::place, allow_hyphen_values = true, requires = "orbit")]
    orbit_centre: Option<DVec3>,
    /// Radius of the circle [default: the light's distance from the axis, at least a quarter of the scene's narrower side]
    #[arg(long, value_name = "LENGTH", value_parser = parse::positive, allow_hyphen_values = true, requires = "orbit")]
    orbit_radius: Option<f64>,
}

/// An orbit that can be made: pictures, and which light goes round.
pub struct Round {
    frames: usize,
    light: usize,
}

impl Orbit {
    /// What is to be made of `scene`, by a bake with `options`; `None` if there shall be no orbit. Whatever is wrong with it is
    /// told here, before the bake.
    ///
    /// # Errors
    /// [`Error::Scene`] without light, [`Error::Option`] for a light that is not there or does not move, and those of
    /// [`Relighter::check`].
    pub fn round(&self, scene: &Scene, options: &BakeOptions) -> Result<Option<Round>> {
        let Some(frames) = self.orbit else { return Ok(None) };
        if !scene.has_light() {
            return Err(Error::Scene(scene.no_light_message()));
        }
        Relighter::check(options)?;
        Ok(Some(Round { frames, light: self.light(&sources(scene))? }))
    }

    /// Lights the pictures of the bake of `scene`, whose rows are all in `rows`, and writes them with one exposure. The bake is
    /// lost.
    ///
    /// # Errors
    /// Those of [`Relighter::with_rows`] and of writing.
    pub fn write(
        &self,
        Round { frames, light }: Round,
        (scene, bake, rows): (&Scene, Bake, &Rows),
        results: &Results,
        mut staged: Staged,
        progress: &dyn Progress,
    ) -> Result<()> {
        let camera = results.picture.camera(scene, &bake);
        let mut relighter = Relighter::with_rows(scene.clone(), bake, rows)?;
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

    /// The number of the light that is asked for; by default that of the first which is no sky, as skies do not turn.
    fn light(&self, sources: &[Source]) -> Result<usize> {
        let names: Vec<&str> = sources.iter().map(|s| s.name()).collect();
        let wrong = |what: String| Err(Error::Option(format!("{what}; there are: {}", names.join(", "))));
        let found = match &self.orbit_light {
            None => sources.iter().position(|s| !is_sky(s)),
            Some(asked) => {
                let material = format!("material \"{asked}\"");
                let number = || asked.parse().ok().filter(|n| *n < names.len());
                let Some(found) = names.iter().position(|name| *name == material).or_else(number) else {
                    return wrong(format!("--orbit-light: there is no light \"{asked}\" to go round"));
                };
                Some(found).filter(|&k| !is_sky(&sources[k]))
            }
        };
        found.map_or_else(|| wrong("--orbit: skies do not go round".into()), Ok)
    }
}

fn is_sky(source: &Source) -> bool {
    matches!(source.light(), Some(WorldLight::Sky { .. } | WorldLight::Environment(..)))
}
