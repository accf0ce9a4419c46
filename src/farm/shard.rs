//! One shard: casting it, and reading what was cast.

use std::{collections::BTreeMap, fs, io, path::PathBuf, thread, time::Duration};

use serde::{Deserialize, Serialize};

use super::{
    Plan,
    plan::{SIGHT, check_there},
};
use crate::{
    Error, Result,
    bake::{self, Outline, ROWS_A_BLOCK, Run},
    estimate,
    lock::Lock,
    lxt::{
        Checkpoint, Container, Identity, Name,
        rows::{self, AGAIN, Entries, ROWS},
        stencils, write_file,
    },
    outlook::{Outlook, STENCIL},
    output::atomic::sweep,
    progress::{self, Progress},
    reconstruct::Stencils,
    simplify::Simplified,
    trace::{self, RayTracer},
    transfer::{self, Block, Casting, RowKeeper, Rows},
};

const SHARD: Name = Name::new("shard");
const IDENTITY: Name = Name::new("identity");
const SETTINGS: Name = Name::new("settings");

/// Who asks whether a shard is being cast holds its lock for a moment; who wants to cast it tries again so often.
const TRIES: u32 = 3;
const PAUSE: Duration = Duration::from_millis(30);

/// Bytes of a point besides its stencil: in the file and as read. And while the stencil is found, where up to 16 patches are asked.
const POINT: usize = 2 * 24;
const FOUND: usize = 24 + 2 * 4 + 8 * (16 + 8);
/// What stencils need besides. Bytes a patch: its place in the index (14), how far it reaches, in the file and twice as read (12),
/// whether it is known (2). Bytes a triangle: its normal (12), and its sides (2).
const INDEXED: usize = 14 + 12 + 2;
const TRIANGLE: usize = 12 + 2;

/// Points whose stencils are made before somebody may ask to stop, in units of [`Stencils::TOGETHER`].
const POINTS: usize = 256;

/// What came of the order to cast a shard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cast {
    /// It was cast, with so many rays; so many rows were there from an attempt that was interrupted.
    Now {
        /// Rays.
        rays: u64,
        /// Rows of an earlier attempt.
        resumed: usize,
    },
    /// It was there, whole and sound.
    Before,
    /// There is no shard of this number: schedulers of arrays may ask for more than there are.
    Beyond,
}

/// What a shard is of, besides the build and the surfaces.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
struct Settings {
    /// The plan, by its content.
    plan: String,
    /// The number of the shard.
    shard: usize,
    /// Settings by their names, as JSON.
    options: BTreeMap<String, String>,
}

/// The rows of a shard, in blocks: an index of all patches for each of many shards would take more than these.
pub(super) struct Shard {
    pub rows: Vec<Block>,
    pub again: Vec<Block>,
    /// Of its part of the vertices, where shards make them.
    pub stencils: Option<Stencils>,
}

impl Plan {
    /// Casts the rows of shard `k`, if it is not there. What an interrupted attempt has written down is used; rows are
    /// written down so often as `checkpoint_every` says. Of the scene nothing is built but the patches and the surfaces that
    /// rays meet.
    ///
    /// # Errors
    /// [`Error::Busy`] if another process casts it, [`Error::Interrupted`] if the progress of `run` asks to stop,
    /// [`Error::Io`]; [`Error::Input`] if the plan is damaged; those of the keeper of `run`.
    pub fn cast(&self, k: usize, checkpoint_every: Duration, run: &mut Run) -> Result<Cast> {
        if k >= self.shards().len() {
            return Ok(Cast::Beyond);
        }
        let outline = self.outline()?;
        if self.shard(k, &outline, Entries::Copied).is_ok() {
            return Ok(Cast::Before);
        }
        let _lock = self.lock(k)?;
        // Its last holder may have finished it.
        if self.shard(k, &outline, Entries::Copied).is_ok() {
            return Ok(Cast::Before);
        }
        sweep(self.folder(), &format!("shard-{k}.lxt"));
        let simplified = self.simplified()?;
        let options = self.options();
        let tracer = trace::build(options.backend, &simplified.geometry)?;
        let points = self.row_points(&*tracer)?;
        let casting = Casting { marked: true, ..Casting::new(&simplified, &*tracer, &outline.outer, &points) };
        let (own, other) = self.rows_of(k, &outline);
        let (mut rows, mut again) = (Rows::new(self.patches()), Rows::new(self.patches()));
        let checkpoint = Checkpoint::of(self.checkpoint_path(k), self.identity().clone(), options, checkpoint_every)?;
        let mut journal = Journal { keeper: &mut *run.keeper, checkpoint, again: false };
        if let Err(Error::Input { .. }) = journal.checkpoint.resume(&mut rows, Some(&mut again)) {
            // It is of something else; nobody asked for it to be used.
            journal.checkpoint.discard()?;
        }
        let resumed = own.iter().filter(|&&i| rows.get(i).is_some()).count();
        let progress = run.progress;
        let missing: Vec<u32> = own.iter().copied().filter(|&i| rows.get(i).is_none()).collect();
        let foretell = || {
            let points = self.points_of(k);
            let found = points.min(POINTS * Stencils::TOGETHER) * FOUND;
            let known = simplified.patches.len() * INDEXED + simplified.geometry.triangles.len() * TRIANGLE;
            let stencils = if points > 0 { points * (POINT + STENCIL) + found + known } else { 0 };
            // Those of other rays take about as much.
            let rows = bake::of_rows(&casting, &[&missing[..], &other].concat(), progress)?;
            Ok(Outlook { rest: stencils as u64, ..rows })
        };
        journal.keeper.begin(&mut rows, &foretell)?;
        let cast = journal.cast(&casting, [&own, &other], &outline.few, [&mut rows, &mut again], progress);
        let done = cast.and_then(|rays| Ok((rays, self.stencils(k, &simplified, &*tracer, progress)?)));
        if done.is_err() {
            // Nobody asks an interrupted shard twice; where the disk is full, that was the error.
            journal.checkpoint.flush().ok();
        }
        let (rays, stencils) = done?;

        // Where the plan has vanished in the meantime its folder is not made anew: nobody would look for the shard there.
        check_there(self.folder())?;
        write_file(&self.shard_path(k), SHARD, |out| {
            out.json(IDENTITY, 0, self.identity())?;
            out.json(SETTINGS, 0, &self.settings(k))?;
            rows::write_in_order(out, ROWS, &rows, ROWS_A_BLOCK)?;
            rows::write_in_order(out, AGAIN, &again, ROWS_A_BLOCK)?;
            stencils.as_ref().map_or(Ok(()), |stencils| stencils::write_alone(out, stencils))
        })?;
        journal.checkpoint.remove()?;
        Ok(Cast::Now { rays, resumed })
    }

    /// Which patches the vertices of shard `k` take their light from, if shards make that.
    fn stencils(
        &self,
        k: usize,
        simplified: &Simplified,
        tracer: &dyn RayTracer,
        progress: &dyn Progress,
    ) -> Result<Option<Stencils>> {
        let Some(sight) = self.sight()? else { return Ok(None) };
        if !sight.fits(simplified.patches.len(), simplified.geometry.triangles.len()) {
            return Err(self.file.wrong(SIGHT, 0, "is not of these patches"));
        }
        let points = self.points(k)?;
        progress.begin("vertices", points.len() as u64);
        let stencils = sight.in_field(simplified, tracer, self.options(), |field| {
            let mut stencils = Stencils::with_room_for(points.len());
            for part in points.chunks(POINTS * Stencils::TOGETHER) {
                progress::go_on(progress, "vertices")?;
                stencils.append(Stencils::new(field, part));
                progress.advance(part.len() as u64);
            }
            Ok::<_, Error>(stencils)
        })?;
        progress.end();
        Ok(Some(stencils))
    }

    /// The rows of shard `k`, if all of them are there and sound.
    pub(super) fn shard(&self, k: usize, outline: &Outline, entries: Entries) -> Result<Shard> {
        let (path, patches) = (self.shard_path(k), self.patches());
        let file = Container::open(&path, SHARD)?;
        let wrong = |what: String| Error::input(&path, "", what);
        let identity: Identity = file.json(IDENTITY, 0)?;
        if let Some(difference) = identity.build.difference(&self.identity().build) {
            return Err(wrong(format!("was made by another build: {difference}")));
        }
        if identity.surfaces != self.identity().surfaces {
            return Err(wrong("is of another scene".into()));
        }
        let settings: Settings = file.json(SETTINGS, 0)?;
        if let Some(difference) = settings.difference(&self.settings(k)) {
            return Err(wrong(difference));
        }
        file.verify()?;
        let read = |kind: Name| rows::read_blocks(&file, kind, patches, entries);
        let stencils = match self.has_sight() {
            true => Some(stencils::read_alone(&file, self.points(k)?, patches)?),
            false => None,
        };
        let shard = Shard { rows: read(ROWS)?, again: read(AGAIN)?, stencils };
        let (own, other) = self.rows_of(k, outline);
        let rays = self.options().rays;
        let few = |i: u32| outline.few.get(i as usize).is_some_and(|&few| few);
        let all = has(&shard.rows, &own, |i| transfer::row_length(rays, few(i))) && has(&shard.again, &other, |_| rays);
        if all { Ok(shard) } else { Err(wrong("lacks rows".into())) }
    }

    fn settings(&self, shard: usize) -> Settings {
        let options: BTreeMap<String, String> = match serde_json::to_value(self.options()) {
            Ok(serde_json::Value::Object(all)) => all.iter().map(|(name, v)| (name.clone(), v.to_string())).collect(),
            _ => BTreeMap::new(),
        };
        Settings { plan: self.id(), shard, options }
    }

    fn lock(&self, k: usize) -> Result<Lock> {
        let take = || Lock::take(&self.shard_path(k), self.lock_path(k), &format!("luxel farm shard {k}"));
        for _ in 1..TRIES {
            match take() {
                Err(Error::Busy { .. }) => thread::sleep(PAUSE),
                taken => return taken,
            }
        }
        take()
    }

    /// The file of shard `k`.
    pub fn shard_path(&self, k: usize) -> PathBuf {
        self.folder().join(format!("shard-{k}.lxt"))
    }

    pub(super) fn checkpoint_path(&self, k: usize) -> PathBuf {
        self.folder().join(format!("shard-{k}.checkpoint"))
    }

    pub(super) fn lock_path(&self, k: usize) -> PathBuf {
        self.folder().join(format!(".shard-{k}.lock"))
    }

    /// Whether there is a file of shard `k`, sound or not.
    pub(super) fn is_there(&self, k: usize) -> bool {
        !matches!(fs::metadata(self.shard_path(k)), Err(e) if e.kind() == io::ErrorKind::NotFound)
    }
}

/// Whether `blocks` have rows of all `patches`, of so many rays.
fn has(blocks: &[Block], patches: &[u32], rays: impl Fn(u32) -> u32) -> bool {
    let mut there: Vec<(u32, u32)> = blocks.iter().flat_map(|b| &b.rows).map(|row| (row.patch, row.rays())).collect();
    there.sort_unstable();
    patches.iter().all(|&i| there.binary_search(&(i, rays(i))).is_ok())
}

impl Settings {
    /// Names what differs, e.g. `rays 256 there, 64 here`; `None` if nothing does.
    fn difference(&self, here: &Settings) -> Option<String> {
        let differs = |(name, here): (&String, &String)| {
            let there = self.options.get(name).filter(|there| *there != here)?;
            Some(format!("{} {there} there, {here} here", name.replace('_', " ")))
        };
        let differences: Vec<String> = here.options.iter().filter_map(differs).collect();
        if !differences.is_empty() {
            return Some(format!("was made with other settings: {}", differences.join("; ")));
        }
        if self.plan != here.plan {
            return Some("is of another plan of this scene".into());
        }
        (self.shard != here.shard).then(|| format!("is shard {}", self.shard))
    }
}

/// Writes down what is cast.
struct Journal<'a> {
    /// Where rows stay.
    keeper: &'a mut dyn RowKeeper,
    checkpoint: Checkpoint,
    /// Whether rows of other rays come.
    again: bool,
}

impl Journal<'_> {
    /// Casts the rows of a shard, and those of other rays; how many rays that took.
    fn cast(
        &mut self,
        casting: &Casting,
        [own, other]: [&[u32]; 2],
        few: &[bool],
        [rows, again]: [&mut Rows; 2],
        progress: &dyn Progress,
    ) -> Result<u64> {
        let rays = transfer::cast(casting, own, few, rows, self, progress)?;
        self.again = true;
        Ok(rays + estimate::replicate(casting, other, again, self, progress)?)
    }
}

impl RowKeeper for Journal<'_> {
    fn keep(&mut self, block: Block) -> Result<Block> {
        let block = self.keeper.keep(block)?;
        self.checkpoint.add(&block, self.again)?;
        Ok(block)
    }
}
