//! The results of a bake: pictures and files, the same whatever command made them.

use std::{
    path::{Path, PathBuf},
    time::Instant,
};

use glam::DVec3;
use luxel::{
    Result, Scene,
    bake::Bake,
    options::PatchSource,
    output::{
        Sight,
        atomic::Staged,
        camera,
        exr::{self, Compression},
        glb::LitMesh,
        hidden_backs, layers, ply, png,
        preview::{self, Preview},
        report::{PreviewRecord, Record, peak_memory_bytes, summary},
        tonemap::ToneMap,
    },
    progress::{self, Progress},
    report::Stage,
    scene::Camera,
    simplify::patch_mesh,
};

use super::{args::Running, parse, say};

/// Where the results go, and what the pictures show.
#[derive(clap::Args, Debug)]
pub struct Results {
    /// Folder for the results; made if it is missing
    #[arg(long, short, value_name = "DIR")]
    output: PathBuf,
    #[command(flatten)]
    pub picture: Picture,
}

#[derive(clap::Args, Debug)]
#[command(next_help_heading = "Preview")]
pub struct Picture {
    /// Make no pictures
    #[arg(long)]
    no_preview: bool,
    /// Pixels of the pictures
    #[arg(long, value_name = "WxH", value_parser = parse::size, default_value = "640x480")]
    pub preview_size: (u32, u32),
    /// Factor on radiance, for pictures and colours; without it one is chosen that makes the brightest 2 % white
    #[arg(long, value_name = "X", value_parser = parse::positive_f32, allow_hyphen_values = true)]
    pub exposure: Option<f32>,
    /// Position and target of the camera, instead of the scene's or an automatic one
    #[arg(long, value_name = "X,Y,Z:X,Y,Z", value_parser = parse::view, allow_hyphen_values = true)]
    camera: Option<(DVec3, DVec3)>,
    /// Which way is up in the pictures [default: the scene's camera's, else 0,1,0]
    #[arg(long, value_name = "X,Y,Z", value_parser = parse::direction, allow_hyphen_values = true)]
    up: Option<DVec3>,
    /// Vertical angle of view of the camera, degrees [default: the scene's camera's, else 45]
    #[arg(long, value_name = "DEGREES", value_parser = parse::view_angle, allow_hyphen_values = true)]
    fov: Option<f64>,
}

impl Results {
    /// Where the results go.
    pub fn place(&self) -> &Path {
        &self.output
    }

    /// Makes the folder, proves that files can be written in it, and keeps other processes out of it.
    ///
    /// # Errors
    /// Those of [`Staged::open_alone`].
    pub fn open(&self) -> Result<Staged> {
        Staged::open_alone(&self.output, "luxel")
    }

    /// Makes the pictures and writes all files.
    ///
    /// # Errors
    /// Those of writing them; what was in the folder then stays.
    pub fn write(&self, scene: &Scene, bake: &mut Bake, staged: Staged, progress: &dyn Progress) -> Result<()> {
        let picture = (!self.picture.no_preview).then(|| {
            let begun = Instant::now();
            let camera = self.picture.camera(scene, bake);
            let pixels = preview::render(scene, bake, &camera, self.picture.preview_size, progress);
            bake.report.stages.push(Stage { name: "preview", seconds: begun.elapsed().as_secs_f64() });
            (camera, pixels)
        });
        progress.begin("output", 0);
        write(&self.picture, scene, bake, picture, staged, progress)?;
        progress.end();
        Ok(())
    }

    /// Pixels of each picture; 0 if none are made.
    pub fn pixels(&self) -> u64 {
        let (width, height) = self.picture.preview_size;
        if self.picture.no_preview { 0 } else { width as u64 * height as u64 }
    }

    /// Tells a terminal of the bake and where its files are.
    pub fn tell(&self, scene: &Scene, bake: &Bake, running: &Running) {
        if !running.quiet && !running.json_progress {
            say(&summary(scene, &bake.report));
            say(&format!("{:<14}{}\n", "written to", self.output.display()));
        }
    }
}

impl Picture {
    /// The camera: that of the arguments, else the scene's, else an automatic one.
    pub fn camera(&self, scene: &Scene, bake: &Bake) -> Camera {
        let up = self.up.or(scene.camera.map(|c| c.up)).unwrap_or(DVec3::Y);
        let own = scene.camera.map(|c| Camera { up, vertical_fov: self.fov.unwrap_or(c.vertical_fov), ..c });
        let given = self.camera.map(|(position, target)| Camera {
            position,
            target,
            up,
            vertical_fov: self.fov.or(scene.camera.map(|c| c.vertical_fov)).unwrap_or(45.0),
        });
        given.or(own).unwrap_or_else(|| {
            let hidden = hidden_backs(scene);
            let brightness = camera::brightness(scene, &bake.mesh, &bake.vertices);
            let aspect = self.preview_size.0 as f32 / self.preview_size.1 as f32;
            let automatic = camera::automatic(scene, &Sight::new(bake.tracer(), &hidden), &brightness, up, aspect);
            Camera { vertical_fov: self.fov.unwrap_or(automatic.vertical_fov), ..automatic }
        })
    }
}

fn write(
    args: &Picture,
    scene: &Scene,
    bake: &mut Bake,
    picture: Option<(Camera, Preview)>,
    mut staged: Staged,
    progress: &dyn Progress,
) -> Result<()> {
    let begun = Instant::now();
    let go_on = || progress::go_on(progress, "output");
    go_on()?;
    let source = bake.report.settings.as_ref().map_or(PatchSource::Surfels, |settings| settings.patches);
    let voxel_size = bake.report.counts.voxel_size;
    staged.write("vertices.ply", |out| {
        ply::write_vertices(out, &bake.mesh, &bake.vertices, bake.error.as_ref(), &scene.frame, voxel_size)
    })?;
    go_on()?;
    let lit = LitMesh::new(scene, &bake.mesh, &bake.vertices);
    let exposed = |automatic: ToneMap| args.exposure.map_or(automatic, |exposure| ToneMap { exposure });
    let tone = exposed(lit.tone());
    staged.write("lit.glb", |out| lit.write(out, scene, tone))?;
    go_on()?;
    let stand_in = match source {
        PatchSource::Surfels | PatchSource::Faces => None,
        PatchSource::Decimated | PatchSource::Clustered | PatchSource::Proxy => Some(patch_mesh(&bake.simplified)),
    };
    let patches = ply::PatchFile {
        mesh: stand_in.as_ref().unwrap_or(&bake.mesh),
        patches: bake.patches(),
        light: &bake.light,
        frame: &scene.frame,
        voxel_size,
        tone,
        squares: source == PatchSource::Faces,
    };
    staged.write("patches.ply", |out| patches.write(out))?;
    let mut record = None;
    if let Some((camera, preview)) = picture {
        let tone = exposed(preview.tone());
        let exitance = preview.exitance_radiance();
        let pictures = [
            ("1-direct.png", &preview.direct),
            ("2-patches.png", &exitance),
            ("3-secondary.png", &preview.secondary),
            ("4-combined.png", &preview.combined),
        ];
        for (name, pixels) in pictures {
            go_on()?;
            staged.write(name, |out| png::write(out, preview.width, preview.height, pixels, tone))?;
        }
        staged.write_path("preview.exr", |path| {
            exr::write(path, &layers::image(&preview, &bake.report), Compression::Zip)
        })?;
        record = Some(PreviewRecord::new(&camera, args.preview_size, tone.exposure));
    }
    bake.report.stages.push(Stage { name: "output", seconds: begun.elapsed().as_secs_f64() });
    bake.report.peak_memory_bytes = peak_memory_bytes();
    // Names of files need not be text.
    let command: Vec<String> = std::env::args_os().map(|word| word.to_string_lossy().into_owned()).collect();
    let record = Record { command: &command, scene: &scene.name, report: &bake.report, preview: record };
    staged.write("bake.json", |out| record.write(out))?;
    go_on()?;
    staged.commit().map(drop)
}
