//! What happens to the rows of a bake while they are cast: they may be written down, or moved out of memory.

use std::path::{Path, PathBuf};

use luxel::{
    Error, Result,
    outlook::Outlook,
    transfer::{Block, RowKeeper, Rows, Spill},
};

use super::parse;

/// How much memory the command may take.
#[derive(clap::Args, Debug)]
#[command(next_help_heading = "Running")]
pub struct Memory {
    /// Take at most so much memory, such as 900M or 4G: it is foretold once the patches are known. Form factors that do
    /// not fit go to a file, and what does not fit even so is not begun
    #[arg(long, value_name = "SIZE", value_parser = parse::memory)]
    memory_limit: Option<u64>,
    /// Folder on a disk for form factors that do not fit the limit [default: that of the output]
    #[arg(long, value_name = "DIR", requires = "memory_limit")]
    spill_dir: Option<PathBuf>,
}

impl Memory {
    /// A keeper that minds the limit, for a command that writes to `folder` and makes pictures of so many pixels.
    pub fn keeper(&self, folder: &Path, pixels: u64) -> Keeper {
        let folder = self.spill_dir.clone().unwrap_or(folder.into());
        Keeper { limit: self.memory_limit, folder, pixels, foretold: None, spill: None }
    }
}

/// Minds the memory.
pub struct Keeper {
    limit: Option<u64>,
    /// Where rows are spilled to.
    folder: PathBuf,
    pixels: u64,
    /// Largest memory that was foretold, bytes.
    foretold: Option<u64>,
    spill: Option<Spill>,
}

impl Keeper {
    /// Largest memory that was foretold, bytes, if there is a limit.
    pub fn foretold(&self) -> Option<u64> {
        self.foretold
    }

    fn weigh(&mut self, limit: u64, outlook: &Outlook) -> Result<()> {
        let (whole, spilled) = (outlook.most(self.pixels, false), outlook.most(self.pixels, true));
        self.foretold = Some(if whole <= limit { whole } else { spilled });
        if whole <= limit {
            self.spill = None;
            return Ok(());
        }
        let mb = |bytes: u64| bytes as f64 * 1e-6;
        if spilled > limit {
            return Err(Error::Option(format!(
                "the bake would take {:.0} MB of memory, {:.0} MB with its form factors ({:.0} MB) on the disk, and \
                 --memory-limit allows {:.0} MB; choose a larger --voxel (a smaller --grid), or allow more",
                mb(whole),
                mb(spilled),
                mb(outlook.rows),
                mb(limit)
            )));
        }
        let room = fs4::available_space(&self.folder).map_err(|e| Error::io(&self.folder, e))?;
        if room < outlook.rows {
            return Err(Error::Option(format!(
                "the bake would take {:.0} MB of memory, and --memory-limit allows {:.0} MB; its form factors ({:.0} MB) \
                 do not fit the disk of {} either, which has room for {:.0} MB; choose another --spill-dir, fewer \
                 --rays, or a larger --voxel",
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
    fn begin(&mut self, _rows: &mut Rows, outlook: &dyn Fn() -> Result<Outlook>) -> Result<()> {
        match self.limit {
            Some(limit) => self.weigh(limit, &outlook()?),
            None => Ok(()),
        }
    }

    fn keep(&mut self, block: Block) -> Result<Block> {
        match &mut self.spill {
            Some(spill) => spill.put(block),
            None => Ok(block),
        }
    }
}
