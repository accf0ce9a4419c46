//! How far the shards of a plan are.

use std::fmt;

use rayon::prelude::*;
use serde::Serialize;

use super::{Part, Plan};
use crate::{
    Result,
    lock::Lock,
    lxt::{Checkpoint, rows::Entries},
};

/// What has become of a shard.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ShardState {
    /// Nobody casts it; there may be rows of an interrupted attempt.
    Open,
    /// Somebody casts it.
    Running,
    /// It is there, whole and sound.
    Done,
    /// There is a file that cannot be used.
    Broken,
}

impl fmt::Display for ShardState {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.pad(match self {
            ShardState::Open => "open",
            ShardState::Running => "running",
            ShardState::Done => "done",
            ShardState::Broken => "broken",
        })
    }
}

/// How far a shard is.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ShardStatus {
    /// Its number.
    pub shard: usize,
    /// What has become of it.
    pub state: ShardState,
    /// Rows that it shall have.
    pub rows: usize,
    /// Rows that are written down.
    pub rows_done: usize,
    /// Foreseen seconds on one thread.
    pub seconds: f64,
    /// Who casts it: what, process, host, since when.
    pub holder: Option<String>,
    /// What is wrong with its file.
    pub problem: Option<String>,
}

impl Plan {
    /// How far each shard is. All files are read, and compared with their checksums.
    ///
    /// # Errors
    /// [`Error::Input`](crate::Error::Input) if the plan is damaged.
    pub fn status(&self) -> Result<Vec<ShardStatus>> {
        let outline = self.outline()?;
        let of = |(k, part): (usize, &Part)| {
            let rows = self.rows_of(k, &outline).0.len();
            let mut status = ShardStatus {
                shard: k,
                state: ShardState::Open,
                rows,
                rows_done: 0,
                seconds: part.seconds,
                holder: None,
                problem: None,
            };
            match self.is_there(k).then(|| self.shard(k, &outline, Entries::Copied)) {
                Some(Ok(_)) => {
                    (status.state, status.rows_done) = (ShardState::Done, rows);
                    return status;
                }
                Some(Err(e)) => (status.state, status.problem) = (ShardState::Broken, Some(e.to_string())),
                None => {}
            }
            status.rows_done = Checkpoint::rows_in(&self.checkpoint_path(k)).unwrap_or(0).min(rows);
            status.holder = Lock::holder(&self.lock_path(k));
            if status.holder.is_some() {
                status.state = ShardState::Running;
            }
            status
        };
        Ok(self.shards().par_iter().enumerate().map(of).collect())
    }
}
