//! All shards together.

use std::path::Path;

use rayon::prelude::*;

use super::{Plan, submit::command};
use crate::{
    Error, Result, Scene,
    bake::{self, Kept, Run},
    lock::Lock,
    lxt::{
        Transfer,
        rows::{self, Entries, ROWS},
    },
    outlook::Outlook,
    reconstruct::Stencils,
    transfer::Rows,
};

/// Shards of which one message says what is wrong with each.
const NAMED: usize = 20;

impl Plan {
    /// The scene.
    ///
    /// # Errors
    /// [`Error::Input`] if the plan is damaged; those of [`Source::build`](crate::scene::Source::build).
    pub fn scene(&self) -> Result<Scene> {
        self.source()?.build()
    }

    /// What all shards have made, for [`prepare`](crate::bake::prepare) and [`bake_with`](crate::bake::bake_with): these
    /// need cast no row.
    ///
    /// # Errors
    /// [`Error::Shards`] naming those that are missing or cannot be used; [`Error::Input`] if the plan is damaged.
    pub fn merge(&self) -> Result<Kept> {
        let kept = self.gather(Entries::Checked)?;
        Ok(Kept { simplified: Some(self.simplified()?), ..kept })
    }

    /// Writes the transfer file that [`prepare`](bake::prepare) and [`Transfer::write`] make of the scene: what shards and
    /// plan hold is copied, after a look at the checksums.
    ///
    /// # Errors
    /// Those of [`Plan::merge`] and [`Transfer::write`].
    pub fn merge_to_file(&self, path: &Path, run: &mut Run) -> Result<()> {
        // What matters to the wanted meshes is in the rows, else nobody reads them here.
        let entries = if self.options().only.is_empty() { Entries::Copied } else { Entries::Checked };
        let mut kept = self.gather(entries)?;
        if let Some(stencils) = kept.stencils.take() {
            let rest = self.file.unread() + size_of_val(stencils.parts().0);
            run.keeper.begin(&mut kept.rows, &|| Ok(Outlook { rest: rest as u64, ..Outlook::of_rows(0.0) }))?;
            return Transfer::copy(path, &self.file, &Kept { stencils: Some(stencils), ..kept });
        }
        kept.simplified = Some(self.simplified()?);
        let source = self.source()?;
        let scene = source.clone().build()?;
        bake::prepare(&scene, self.options(), &mut kept, run)?;
        Transfer::write(path, &source, &scene, self.options(), &kept)
    }

    /// All but the patches; stencils only if the rows agree with what these were made with.
    fn gather(&self, entries: Entries) -> Result<Kept> {
        let patches = self.patches();
        let outline = self.outline()?;
        let read: Vec<_> = (0..self.shards().len()).into_par_iter().map(|k| self.shard(k, &outline, entries)).collect();
        let mut rows: Rows = rows::read_all(&self.file, ROWS, patches, entries)?;
        let mut again = Rows::new(patches);
        let (mut stencils, mut flaws) = (Vec::new(), Vec::new());
        for (k, shard) in read.into_iter().enumerate() {
            match shard {
                Ok(shard) => {
                    shard.rows.into_iter().for_each(|block| rows.add(block));
                    shard.again.into_iter().for_each(|block| again.add(block));
                    stencils.extend(shard.stencils);
                }
                Err(error) => flaws.push((k, error)),
            }
        }
        if !flaws.is_empty() {
            return Err(self.unfinished(&flaws));
        }
        let holds = self.sight()?.is_some_and(|sight| sight.known == rows.visible());
        let stencils = holds.then(|| Stencils::joined(stencils));
        Ok(Kept { rows, again, stencils, marked: true, ..Kept::default() })
    }

    fn unfinished(&self, flaws: &[(usize, Error)]) -> Error {
        let [again, status] = ["shard", "status"].map(|name| command(name, self.folder()));
        let flaw = |(k, error): &(usize, Error)| match (Lock::holder(&self.lock_path(*k)), self.is_there(*k)) {
            (Some(holder), _) => format!("\n  shard {k} is not done: wait for {holder}"),
            (None, false) => format!("\n  shard {k} is missing: {again} {k}"),
            (None, true) => format!("\n  shard {k} cannot be used ({error}): {again} {k}"),
        };
        let mut text = format!("{} of {} shards are not there to be merged:", flaws.len(), self.shards().len());
        text.extend(flaws.iter().take(NAMED).map(flaw));
        if let Some(others) = flaws.get(NAMED..).filter(|others| !others.is_empty()) {
            let numbers: Vec<usize> = others.iter().map(|(k, _)| *k).collect();
            text += &format!("\n  and {} more, {}: see {status}", others.len(), ranges(&numbers));
        }
        Error::Shards { path: self.folder().into(), flaws: text }
    }
}

/// Numbers in rising order as schedulers write them: `3,7-9`.
fn ranges(numbers: &[usize]) -> String {
    let runs = numbers.chunk_by(|a, b| a + 1 == *b).map(|run| match (run[0], run[run.len() - 1]) {
        (first, last) if first == last => first.to_string(),
        (first, last) => format!("{first}-{last}"),
    });
    runs.collect::<Vec<_>>().join(",")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_written_as_schedulers_read_them() {
        assert_eq!(ranges(&[3]), "3");
        assert_eq!(ranges(&[0, 1, 3, 7, 8, 9]), "0-1,3,7-9");
    }
}
