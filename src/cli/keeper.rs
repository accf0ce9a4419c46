//! What happens to the rows of a bake while they are cast: they may be written down, or moved out of memory.

use std::{
    io,
    path::{Path, PathBuf},
    time::Duration,
};

use luxel::{
    BakeOptions, Error, Result, Scene,
    bake::Bake,
    lxt::Checkpoint,
    outlook::{Limit, Outlook},
    transfer::{Block, RowKeeper, Rows, Spill},
};

use super::{parse, signals};

/// How much memory the command may take.
#[derive(clap::Args, Debug)]
#[command(next_help_heading = "Running")]
pub struct Memory {
    /// Take at most so much memory, such as 900M or 4G: it is foretold once the patches are known. Form factors that do
    /// not fit go to a file, and what does not fit even so is not begun
    #[arg(long, value_name = "SIZE", value_parser = parse::memory)]
    memory_limit: Option<u64>,
    /// Folder on a disk for form factors that do not fit the limit [default: that of the output, or of the plan]
    #[arg(long, value_name = "DIR", requires = "memory_limit", value_parser = parse::folder())]
    spill_dir: Option<PathBuf>,
}

impl Memory {
    /// A keeper that minds the limit, for a command that writes to `folder` and makes pictures of so many pixels.
    pub fn keeper(&self, folder: &Path, pixels: u64) -> Keeper {
        self.keeper_of(WHOLE, folder, pixels)
    }

    /// As [`Memory::keeper`], of another work.
    pub fn keeper_of(&self, wording: Wording, folder: &Path, pixels: u64) -> Keeper {
        let folder = self.spill_dir.clone().unwrap_or(folder.into());
        Keeper {
            limit: self.memory_limit,
            wording,
            folder,
            pixels,
            foretold: None,
            spill: None,
            checkpoint: None,
            outdated: None,
            resume: false,
            resumed: 0,
            warning: None,
        }
    }
}

/// What the messages of a keeper call the work, and how it would take less.
#[derive(Clone, Copy)]
pub struct Wording {
    work: &'static str,
    remedy: &'static str,
    /// Whether the command takes another size of voxels, so that one that fits can be named.
    has_voxels: bool,
}

/// Of the whole of a bake.
pub const WHOLE: Wording =
    Wording { work: "the bake", remedy: "choose a larger --voxel (a smaller --grid)", has_voxels: true };
/// Of a part of it.
pub const SHARD: Wording = Wording { work: "the shard", remedy: "make a plan of more shards", has_voxels: false };
/// Of its end.
pub const MERGE: Wording =
    Wording { work: "the merge", remedy: "make a plan with a larger --voxel (a smaller --grid)", has_voxels: false };

/// What is asked for as a multiple of what is foretold: that is within a tenth of what it will be.
const ALLOWED: f64 = 1.1;

/// Whether form factors are written down while they are cast.
#[derive(clap::Args, Debug)]
#[command(next_help_heading = "Running")]
pub struct Resume {
    /// Go on from the form factors that an interrupted bake of the same surfaces and settings has left in the output
    /// folder, if there are any
    #[arg(long, conflicts_with_all = ["target_error", "budget", "no_checkpoint"])]
    resume: bool,
    /// How often form factors are written down while they are cast: a bake that is killed loses so much
    #[arg(long, value_name = "TIME", value_parser = parse::time, default_value = "5s")]
    checkpoint_every: Duration,
    /// Do not write form factors down while they are cast: an interrupted bake begins anew. Those of an earlier bake stay in
    /// the output folder until the results are there
    #[arg(long, conflicts_with = "checkpoint_every")]
    no_checkpoint: bool,
}

/// Name of the checkpoint in the output folder.
const CHECKPOINT: &str = ".luxel.checkpoint";

impl Resume {
    /// Has `keeper` write the rows of one bake to a checkpoint in `folder`, or take them up from there.
    ///
    /// # Errors
    /// Those of [`Checkpoint::new`].
    pub fn arm(&self, keeper: &mut Keeper, folder: &Path, scene: &Scene, options: &BakeOptions) -> Result<()> {
        let path = folder.join(CHECKPOINT);
        if self.no_checkpoint {
            keeper.outdated = Some(path);
        } else {
            keeper.checkpoint = Some(Checkpoint::new(path, scene, options, self.checkpoint_every)?);
            keeper.resume = self.resume;
        }
        Ok(())
    }
}

/// Minds the memory, and writes rows down.
pub struct Keeper {
    limit: Option<u64>,
    wording: Wording,
    /// Where rows are spilled to.
    folder: PathBuf,
    pixels: u64,
    /// Largest memory that was foretold, bytes.
    foretold: Option<u64>,
    spill: Option<Spill>,
    checkpoint: Option<Checkpoint>,
    /// A checkpoint, if it is there, that serves nobody once there are results.
    outdated: Option<PathBuf>,
    resume: bool,
    /// Rows that were there already.
    resumed: usize,
    /// Why there is no checkpoint any more.
    warning: Option<String>,
}

impl Keeper {
    /// Tells the report of a finished bake what was done.
    pub fn tell(&self, bake: &mut Bake) {
        bake.report.foretold_memory_bytes = self.foretold;
        if let (Some(checkpoint), true) = (&self.checkpoint, self.resumed > 0) {
            bake.report.rows.from.get_or_insert_with(|| checkpoint.path().display().to_string());
        }
        bake.report.warnings.extend(self.warning.clone());
    }

    /// Writes down what is not yet: the bake was interrupted.
    pub fn save(&mut self) {
        if let Some(Err(error)) = self.checkpoint.as_mut().map(Checkpoint::flush) {
            signals::set_remedy(format!("the last form factors could not be written down: {error}"));
        }
    }

    /// The results are written: the checkpoint goes.
    ///
    /// # Errors
    /// It cannot be removed.
    pub fn finish(self) -> Result<()> {
        if let Some(path) = self.outdated
            && let Err(e) = std::fs::remove_file(&path)
            && e.kind() != io::ErrorKind::NotFound
        {
            return Err(Error::io(path, e));
        }
        self.checkpoint.map_or(Ok(()), Checkpoint::remove)
    }

    fn weigh(&mut self, limit: u64, outlook: &Outlook) -> Result<()> {
        let whole = outlook.most(self.pixels, false);
        let spilled = outlook.most(self.pixels, true).min(whole);
        self.foretold = Some(if whole <= limit { whole } else { spilled });
        if whole <= limit {
            self.spill = None;
            return Ok(());
        }
        let mb = |bytes: u64| bytes as f64 * 1e-6;
        let Wording { work, remedy, has_voxels } = self.wording;
        if spilled > limit {
            let remedy = match outlook.voxels {
                Some(_) if has_voxels => outlook.remedy(Limit { bytes: limit, pixels: self.pixels }),
                _ => Some(remedy.into()),
            };
            let remedy = remedy.map_or(String::new(), |remedy| format!("{remedy}, or "));
            return Err(Error::Option(format!(
                "{work} would take {:.0} MB of memory, {:.0} MB with its form factors ({:.0} MB) on the disk, and \
                 --memory-limit allows {:.0} MB; {remedy}allow {:.0} MB",
                mb(whole),
                mb(spilled),
                mb(outlook.rows),
                mb(limit),
                (mb(spilled) * ALLOWED).ceil()
            )));
        }
        let room = fs4::available_space(&self.folder).map_err(|e| Error::io(&self.folder, e))?;
        if room < outlook.rows {
            return Err(Error::Option(format!(
                "{work} would take {:.0} MB of memory, and --memory-limit allows {:.0} MB; its form factors ({:.0} MB) \
                 do not fit the disk of {} either, which has room for {:.0} MB; choose another --spill-dir, or \
                 {remedy}",
                mb(whole),
                mb(limit),
                mb(outlook.rows),
                self.folder.display(),
                mb(room)
            )));
        }
        self.spill = Some(Spill::new(&self.folder)?);
        Ok(())
    }
}

impl RowKeeper for Keeper {
    fn begin(&mut self, rows: &mut Rows, outlook: &dyn Fn() -> Result<Outlook>) -> Result<()> {
        if let Some(checkpoint) = &mut self.checkpoint {
            if self.resume {
                self.resumed = checkpoint.resume(rows, None)?;
            } else {
                checkpoint.discard()?;
            }
            let path = checkpoint.path().display();
            signals::set_remedy(format!("form factors so far are in {path}; the same command with --resume goes on"));
        }
        match self.limit {
            Some(limit) => self.weigh(limit, &outlook()?),
            None => Ok(()),
        }
    }

    fn limit(&self) -> Option<Limit> {
        self.limit.map(|bytes| Limit { bytes, pixels: self.pixels })
    }

    fn spills(&self) -> bool {
        self.spill.is_some()
    }

    fn keep(&mut self, block: Block) -> Result<Block> {
        let block = match &mut self.spill {
            Some(spill) => spill.put(block)?,
            None => block,
        };
        // The bake can do without: better no checkpoint than no bake.
        if let Some(Err(error)) = self.checkpoint.as_mut().map(|checkpoint| checkpoint.add(&block, false)) {
            self.checkpoint.take().map_or(Ok(()), Checkpoint::remove).ok();
            signals::set_remedy(String::new());
            self.warning = Some(format!("the bake went on without a checkpoint: {error}"));
        }
        Ok(block)
    }
}
