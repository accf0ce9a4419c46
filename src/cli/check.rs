//! `luxel check`.

use luxel::{Result, scene::SceneCheck};

use super::{args::BakeArgs, say};

#[derive(clap::Args, Debug)]
pub struct Args {
    #[command(flatten)]
    bake: BakeArgs,
}

pub fn run(args: &Args) -> Result<()> {
    let job = args.bake.load()?;
    say(&SceneCheck::new(&job.scene).to_string());
    say(&luxel::forecast(&job.scene, &job.options)?.to_string());
    Ok(())
}
