//! Speaking with Slurm: by its commands, as a user does.

use std::{
    io,
    process::{Command, Stdio},
};

use crate::{Error, Result};

/// Tasks of an array where Slurm's configuration does not say otherwise.
const DEFAULT_ARRAY_SIZE: u64 = 1001;

/// A job as `sbatch --parsable` tells of it.
pub struct Job {
    pub number: String,
    /// Where it is another than the default one.
    pub cluster: Option<String>,
}

impl Job {
    /// `123` or `123;cluster`, in the last line: sites print above it.
    pub fn parse(stdout: &str) -> Option<Job> {
        let line = stdout.lines().rev().find(|line| !line.trim().is_empty())?.trim();
        let (number, cluster) = line.split_once(';').map_or((line, None), |(n, c)| (n, Some(c.to_string())));
        let whole = !number.is_empty() && number.bytes().all(|b| b.is_ascii_digit());
        whole.then(|| Job { number: number.into(), cluster })
    }
}

/// Cancels jobs; returns the refusal that was the reason, with what became of them.
pub fn cancel(jobs: &[Job], refusal: Error) -> Error {
    if jobs.is_empty() {
        return refusal;
    }
    let mut fates = Vec::new();
    for Job { number, cluster } in jobs {
        let mut command = Command::new("scancel");
        command.args(cluster.iter().map(|name| format!("--clusters={name}"))).arg(number);
        fates.push(match run(&mut command) {
            Ok(_) => format!("array job {number}, already taken, is cancelled"),
            Err(e) => format!("array job {number}, already taken, could not be cancelled ({e})"),
        });
    }
    Error::Scheduler(format!("{refusal}; {}", fates.join("; ")))
}

/// Runs a command of Slurm; gives what it wrote to standard output and standard error.
pub fn run(command: &mut Command) -> Result<(String, String)> {
    let name = command.get_program().to_string_lossy().into_owned();
    let output = command.stdin(Stdio::null()).output().map_err(|e| match e.kind() {
        io::ErrorKind::NotFound => Error::Scheduler(format!(
            "{name} is not on the PATH: submit on a machine of a Slurm cluster, or run the shards by other means \
             (docs/FARM.md)"
        )),
        _ => Error::Scheduler(format!("{name} cannot be run: {e}")),
    })?;
    let [stdout, stderr] = [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    if output.status.success() {
        return Ok((stdout, stderr));
    }
    let reason = if stderr.trim().is_empty() { output.status.to_string() } else { stderr.trim().replace('\n', "; ") };
    Err(Error::Scheduler(format!("{name} refused: {reason}")))
}

/// How many tasks an array may have; the largest index is one less.
pub fn array_size() -> Result<u64> {
    let config = match Command::new("scontrol").args(["show", "config"]).stdin(Stdio::null()).output() {
        Ok(output) if output.status.success() => String::from_utf8_lossy(&output.stdout).into_owned(),
        // `sbatch` will say what is the matter, if anything.
        _ => return Ok(DEFAULT_ARRAY_SIZE),
    };
    let mut values = config.lines().filter_map(|line| line.split_once('='));
    match values.find(|(key, _)| key.trim() == "MaxArraySize") {
        Some((_, value)) => value
            .trim()
            .parse()
            .map_err(|_| Error::Scheduler(format!("scontrol gives a MaxArraySize of \"{}\"", value.trim()))),
        None => Ok(DEFAULT_ARRAY_SIZE),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_number_of_a_job_is_read_with_its_cluster_and_below_what_a_site_prints() {
        let read = |text| Job::parse(text).map(|job| (job.number, job.cluster));
        assert_eq!(read("17\n"), Some(("17".into(), None)));
        assert_eq!(read("17;big\n"), Some(("17".into(), Some("big".into()))));
        assert_eq!(read("Welcome!\n17\n\n"), Some(("17".into(), None)));
        assert_eq!(read("Submitted batch job 17\n"), None);
        assert_eq!(read(""), None);
    }
}
