//! One shard: casting it, and reading what was cast.

use std::{fs, io, path::PathBuf, thread, time::Duration};

use serde::{Deserialize, Serialize};

use super::{Plan, journal::Journal};
use crate::{
    BakeOptions, Error, Result,
    bake::{Outline, ROWS_A_BLOCK},
    lock::Lock,
    lxt::{
        BuildId, Container, Name,
        rows::{self, AGAIN, ROWS},
        write_file,
    },
    progress::Progress,
    trace,
    transfer::{self, Casting, Rows},
};

const SHARD: Name = Name::new("shard");
const SETTINGS: Name = Name::new("settings");
const NUMBER: Name = Name::new("number");

/// Who asks whether a shard is being cast holds its lock for a moment; who wants to cast it tries again so often.
const TRIES: u32 = 3;
const PAUSE: Duration = Duration::from_millis(30);

/// What the shards of a plan have in common.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// The plan, by its content.
    pub plan: String,
    /// The build.
    pub build: BuildId,
    /// The surfaces, by their hash.
    pub surfaces: String,
    /// The settings.
    pub options: BakeOptions,
}

impl Settings {
    /// Names what differs, e.g. `rays 256 there, 64 here`; `None` if nothing does.
    pub fn difference(&self, here: &Settings) -> Option<String> {
        if let Some(difference) = self.build.difference(&here.build) {
            return Some(format!("it was made by another build: {difference}"));
        }
        if self.surfaces != here.surfaces {
            return Some("it is of another scene".into());
        }
        let fields = |settings: &Settings| match serde_json::to_value(&settings.options) {
            Ok(serde_json::Value::Object(fields)) => fields,
            _ => serde_json::Map::new(),
        };
        let (there, here_fields) = (fields(self), fields(here));
        let differences: Vec<String> = (here_fields.iter())
            .filter_map(|(name, here)| there.get(name).filter(|t| *t != here).map(|t| (name, t, here)))
            .map(|(name, there, here)| format!("{} {there} there, {here} here", name.replace('_', " ")))
            .collect();
        if !differences.is_empty() {
            return Some(format!("it was made with other settings: {}", differences.join("; ")));
        }
        (self.plan != here.plan).then(|| "it is of another plan of this scene".into())
    }
}

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

/// The rows of a shard.
pub(super) struct Shard {
    pub rows: Rows,
    pub again: Rows,
}

impl Plan {
    /// Casts the rows of shard `k`, if it is not there. What an interrupted attempt has written down is used.
    ///
    /// # Errors
    /// [`Error::Busy`] if another process casts it, [`Error::Interrupted`] if `progress` asks to stop, [`Error::Io`];
    /// [`Error::Input`] if the plan is damaged.
    pub fn cast(&self, k: usize, progress: &dyn Progress) -> Result<Cast> {
        if k >= self.shards().len() {
            return Ok(Cast::Beyond);
        }
        let patches = self.patches();
        let outline = self.outline(patches)?;
        if self.shard(k, &outline).is_ok() {
            return Ok(Cast::Before);
        }
        let _lock = self.lock(k)?;
        // Its last holder may have finished it.
        if self.shard(k, &outline).is_ok() {
            return Ok(Cast::Before);
        }
        let simplified = self.simplified()?;
        let options = self.options();
        let tracer = trace::build(options.backend, &simplified.geometry)?;
        let casting = Casting {
            simplified: &simplified,
            tracer: &*tracer,
            outer: &outline.outer,
            rays: options.rays,
            seed: options.seed,
            again: 0,
            marked: true,
        };
        let (own, other) = self.rows_of(k, &outline, patches);
        let settings = self.settings();
        let (mut journal, mut rows, mut again) = Journal::open(self.journal_path(k), &settings, patches)?;
        let resumed = own.iter().filter(|&&i| rows.get(i).is_some()).count();
        let mut rays = 0;
        let mut both = || {
            rays += transfer::cast(&casting, &own, &outline.few, &mut rows, &mut journal, progress)?;
            journal.flush()?;
            journal.kind = AGAIN;
            let casting = Casting { again: 1, marked: false, ..casting };
            rays += transfer::cast(&casting, &other, &[], &mut again, &mut journal, progress)?;
            Ok(())
        };
        if let Err(error) = both() {
            // What was cast is kept, whatever the reason.
            journal.flush()?;
            return Err(error);
        }
        let of = |list: &[u32], i: u32| list.binary_search(&i).is_ok();
        let rows = rows.in_order(ROWS_A_BLOCK, |i| of(&own, i));
        let again = again.in_order(ROWS_A_BLOCK, |i| of(&other, i));
        write_file(&self.shard_path(k), SHARD, |out| {
            out.json(SETTINGS, 0, &settings)?;
            out.json(NUMBER, 0, &k)?;
            rows::write_all(out, ROWS, &rows)?;
            rows::write_all(out, AGAIN, &again)
        })?;
        journal.remove();
        Ok(Cast::Now { rays, resumed })
    }

    /// The rows of shard `k`, if all of them are there and sound.
    pub(super) fn shard(&self, k: usize, outline: &Outline) -> Result<Shard> {
        let (path, patches) = (self.shard_path(k), self.patches());
        let file = Container::open(&path, SHARD)?;
        if let Some(difference) = file.json::<Settings>(SETTINGS, 0)?.difference(&self.settings()) {
            return Err(Error::input(path, "", difference));
        }
        let number: usize = file.json(NUMBER, 0)?;
        if number != k {
            return Err(Error::input(path, "", format!("it is shard {number}")));
        }
        file.verify()?;
        let shard =
            Shard { rows: rows::read_all(&file, ROWS, patches)?, again: rows::read_all(&file, AGAIN, patches)? };
        let (own, other) = self.rows_of(k, outline, patches);
        let rays = self.options().rays;
        let few = |i: u32| outline.few.get(i as usize).is_some_and(|&few| few);
        let is_there = |i: &u32| shard.rows.with_rays(*i, transfer::row_length(rays, few(*i)) as usize).is_some();
        if own.iter().all(is_there) && other.iter().all(|&i| shard.again.with_rays(i, rays as usize).is_some()) {
            Ok(shard)
        } else {
            Err(Error::input(path, "", "rows are missing"))
        }
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

    /// Number of patches.
    pub(super) fn patches(&self) -> usize {
        self.shards().last().map_or(0, |part| part.patches.end as usize)
    }

    /// The file of shard `k`.
    pub fn shard_path(&self, k: usize) -> PathBuf {
        self.folder().join(format!("shard-{k}.lxt"))
    }

    pub(super) fn journal_path(&self, k: usize) -> PathBuf {
        self.folder().join(format!("shard-{k}.journal"))
    }

    pub(super) fn lock_path(&self, k: usize) -> PathBuf {
        self.folder().join(format!(".shard-{k}.lock"))
    }

    /// Whether there is a file of shard `k`, sound or not.
    pub(super) fn is_there(&self, k: usize) -> bool {
        !matches!(fs::metadata(self.shard_path(k)), Err(e) if e.kind() == io::ErrorKind::NotFound)
    }
}
