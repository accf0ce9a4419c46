//! The plan: all that the processes need to know, in one file.

use std::{
    fs,
    io::ErrorKind,
    path::{Path, PathBuf},
    sync::OnceLock,
};

use super::balance::{Divided, Division, Part, Work};
use crate::{
    BakeOptions, Error, Result, Scene,
    bake::{self, Kept, Outline, Outlined, ROWS_A_BLOCK, Run, Shared, Sight},
    estimate,
    lock::Lock,
    lxt::{
        Container, Identity, Name, points,
        rows::{self, ROWS},
        simplified, source, stencils, write_file,
    },
    output::atomic::{Staged, sweep},
    scene::{Source, SurfacePoint},
    simplify::Simplified,
    trace::RayTracer,
    transfer::RowPoints,
};

const PLAN: Name = Name::new("plan");
const IDENTITY: Name = Name::new("identity");
const OPTIONS: Name = Name::new("options");
const OUTLINE: Name = Name::new("outline");
pub(super) const SIGHT: Name = Name::new("sight");
const SHARDS: Name = Name::new("shards");

/// Name of the file in the folder.
pub(super) const FILE: &str = "plan.lxt";

/// An open plan.
pub struct Plan {
    folder: PathBuf,
    pub(super) file: Container,
    identity: Identity,
    options: BakeOptions,
    shards: Vec<Part>,
    /// Patches with rows of other rays, once somebody asks.
    again: OnceLock<Vec<u32>>,
}

impl Plan {
    /// Makes a plan in `folder`: `scene` is built of `source`. Returns it open.
    ///
    /// The division depends on how long some rows took, so it may differ from time to time; the results do not.
    ///
    /// # Errors
    /// Those of [`prepare`](bake::prepare); [`Error::Option`] for no shards, or if there is a plan in the folder already;
    /// [`Error::Busy`] if another process makes one there;
    /// [`Error::Io`] with the path.
    pub fn make(
        folder: &Path,
        source: &Source,
        scene: &Scene,
        options: &BakeOptions,
        division: Division,
        run: &mut Run,
    ) -> Result<Plan> {
        Plan::check_place(folder)?;
        let _lock = Lock::folder(folder, "luxel farm plan")?;
        // Another process may have made one before it left the lock.
        let path = Plan::check_place(folder)?;
        sweep(folder, FILE);
        let identity = Identity::new(scene, options)?;
        let mut kept = Kept::default();
        let outlined = bake::outline(scene, options, &mut kept, run)?;
        let Some(simplified) = &kept.simplified else {
            return Err(Error::Scene(format!("scene \"{}\" has no patches", scene.name)));
        };
        let Divided { shards, points: parts } = Work { simplified, outlined: &outlined, options }.divided(division)?;
        let Outlined { outline, shared, points, .. } = outlined;
        write_file(&path, PLAN, |out| {
            out.json(IDENTITY, 0, &identity)?;
            out.json(SHARDS, 0, &shards)?;
            out.value(OPTIONS, 0, options)?;
            source::write(out, source)?;
            simplified::write_alone(out, simplified)?;
            out.value(OUTLINE, 0, &outline)?;
            points::write(out, points.rows())?;
            if let Some(Shared { points: vertices, sight }) = &shared {
                out.value(SIGHT, 0, sight)?;
                for (k, part) in (0..).zip(parts) {
                    stencils::write_points(out, k, &vertices[part])?;
                }
            }
            rows::write_in_order(out, ROWS, &kept.rows, ROWS_A_BLOCK)
        })?;
        Plan::open(folder)
    }

    /// Proves that a plan can be made in `folder`; makes it if it is missing. Returns the path of the file.
    ///
    /// # Errors
    /// [`Error::Option`] if there is a plan already, [`Error::Io`].
    pub fn check_place(folder: &Path) -> Result<PathBuf> {
        let path = folder.join(FILE);
        if path.exists() {
            return Err(Error::Option(format!(
                "{}: there is a plan already; remove the folder with its shards, or choose another one",
                path.display()
            )));
        }
        Staged::open(folder)?.commit()?;
        Ok(path)
    }

    /// Opens the plan in `folder`.
    ///
    /// # Errors
    /// [`Error::Io`], [`Error::Input`]: see [`Container::open`]; also if another build made it.
    pub fn open(folder: &Path) -> Result<Plan> {
        let path = check_there(folder)?;
        let file = Container::open(&path, PLAN)?;
        let identity: Identity = file.json(IDENTITY, 0)?;
        identity.check_build(&path)?;
        let options: BakeOptions = file.value(OPTIONS, 0)?;
        let shards: Vec<Part> = file.json(SHARDS, 0)?;
        let mut end = 0;
        for Part { patches, .. } in &shards {
            if patches.start != end || patches.end < end {
                return Err(file.wrong(SHARDS, 0, "leaves patches out, or names some twice"));
            }
            end = patches.end;
        }
        // Lists of all patches are made of what this says, some before the patches are read.
        if simplified::count(&file) != end as usize {
            return Err(file.wrong(SHARDS, 0, "is not of these patches"));
        }
        Ok(Plan { folder: folder.into(), file, identity, options, shards, again: OnceLock::new() })
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The settings.
    pub fn options(&self) -> &BakeOptions {
        &self.options
    }

    /// The work of each shard.
    pub fn shards(&self) -> &[Part] {
        &self.shards
    }

    /// What tells this plan from any other.
    pub(super) fn id(&self) -> String {
        self.file.id()
    }

    /// The build and the surfaces.
    pub(super) fn identity(&self) -> &Identity {
        &self.identity
    }

    /// Number of patches.
    pub(super) fn patches(&self) -> usize {
        self.shards.last().map_or(0, |part| part.patches.end as usize)
    }

    /// The scene as it was read.
    ///
    /// # Errors
    /// Those of [`Container::value`].
    pub fn source(&self) -> Result<Source> {
        source::read(&self.file)
    }

    /// The patches, in no colours.
    pub(super) fn simplified(&self) -> Result<Simplified> {
        simplified::read_alone(&self.file)
    }

    /// Whether shards make stencils.
    pub(super) fn has_sight(&self) -> bool {
        self.file.numbers(SIGHT).next().is_some()
    }

    /// What these depend on; `None` if no shard makes any.
    pub(super) fn sight(&self) -> Result<Option<Sight>> {
        self.has_sight().then(|| self.file.value(SIGHT, 0)).transpose()
    }

    /// How many points shard `k` makes stencils of.
    pub(super) fn points_of(&self, k: usize) -> usize {
        stencils::count_points(&self.file, k as u64)
    }

    /// Points whose stencils shard `k` makes.
    pub(super) fn points(&self, k: usize) -> Result<Vec<SurfacePoint>> {
        stencils::read_points(&self.file, k as u64)
    }

    /// Where the rays of rows start and go.
    pub(super) fn row_points(&self, tracer: &dyn RayTracer) -> Result<RowPoints> {
        let rows = points::read(&self.file, self.options.rays, tracer)?;
        Ok(RowPoints::with_rows(rows, self.options.seed, tracer))
    }

    /// How rows are cast.
    pub(super) fn outline(&self) -> Result<Outline> {
        let outline: Outline = self.file.value(OUTLINE, 0)?;
        let fits = |list: &Vec<bool>| list.is_empty() || list.len() == self.patches();
        if [&outline.outer, &outline.few, &outline.spared].into_iter().all(fits) {
            Ok(outline)
        } else {
            Err(self.file.wrong(OUTLINE, 0, "is not of these patches"))
        }
    }

    /// The rows that shard `k` casts, and those of other rays.
    pub(super) fn rows_of(&self, k: usize, outline: &Outline) -> (Vec<u32>, Vec<u32>) {
        let range = self.shards[k].patches.clone();
        let is_spared = |i: &u32| outline.spared.get(*i as usize).is_some_and(|&spared| spared);
        let rows = range.clone().filter(|i| !is_spared(i)).collect();
        let again = self.again.get_or_init(|| match self.options.estimate {
            true => estimate::replicated(self.patches(), self.options.seed),
            false => Vec::new(),
        });
        let at = |patch: u32| again.partition_point(|&i| i < patch);
        (rows, again[at(range.start)..at(range.end)].to_vec())
    }
}

/// Proves that there is a plan in `folder`; gives the path of its file.
pub(super) fn check_there(folder: &Path) -> Result<PathBuf> {
    let path = folder.join(FILE);
    match fs::metadata(&path) {
        Err(e) if [ErrorKind::NotFound, ErrorKind::NotADirectory].contains(&e.kind()) => {
            Err(Error::input(path, "", "there is no plan; name the folder of one that luxel farm plan has made"))
        }
        _ => Ok(path),
    }
}
