//! All shards together.

use rayon::prelude::*;

use super::Plan;
use crate::{
    Error, Result, Scene,
    bake::Kept,
    lxt::rows::{self, ROWS},
    transfer::Rows,
};

/// Shards that are named in one message.
const NAMED: usize = 20;

impl Plan {
    /// The scene.
    ///
    /// # Errors
    /// [`Error::Input`] if the plan is damaged; those of [`Source::build`](crate::scene::Source::build).
    pub fn scene(&self) -> Result<Scene> {
        self.source()?.build()
    }

    /// What all shards have cast, for [`prepare`](crate::bake::prepare) and [`bake_with`](crate::bake::bake_with): these
    /// need cast no row.
    ///
    /// # Errors
    /// [`Error::Shards`] naming those that are missing or cannot be used; [`Error::Input`] if the plan is damaged.
    pub fn merge(&self) -> Result<Kept> {
        let patches = self.patches();
        let outline = self.outline()?;
        let read: Vec<_> = (0..self.shards().len()).into_par_iter().map(|k| self.shard(k, &outline)).collect();
        let mut rows: Rows = rows::read_all(&self.file, ROWS, patches)?;
        let mut again = Rows::new(patches);
        let mut flaws = Vec::new();
        for (k, shard) in read.into_iter().enumerate() {
            match shard {
                Ok(shard) => {
                    shard.rows.blocks().iter().for_each(|block| rows.add(block.clone()));
                    shard.again.blocks().iter().for_each(|block| again.add(block.clone()));
                }
                Err(error) => flaws.push((k, error)),
            }
        }
        if !flaws.is_empty() {
            return Err(self.unfinished(&flaws));
        }
        Ok(Kept { simplified: Some(self.simplified()?), rows, again, marked: true, ..Kept::default() })
    }

    fn unfinished(&self, flaws: &[(usize, Error)]) -> Error {
        let folder = self.folder().display();
        let line = |(k, error): &(usize, Error)| match (self.is_there(*k), error) {
            (false, _) => format!("\n  shard {k} is missing: luxel farm shard {folder} {k}"),
            (true, error) => format!("\n  shard {k} cannot be used ({error}): luxel farm shard {folder} {k}"),
        };
        let mut text = format!("{} of {} shards are not there to be merged; run", flaws.len(), self.shards().len());
        text.extend(flaws.iter().take(NAMED).map(line));
        if flaws.len() > NAMED {
            text += &format!("\n  and {} more: see luxel farm status {folder}", flaws.len() - NAMED);
        }
        Error::Shards { path: self.folder().into(), flaws: text }
    }
}
