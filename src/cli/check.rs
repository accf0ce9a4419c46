//! `luxel check`.

use luxel::{Result, scene::SceneCheck};

use super::{args::BakeArgs, say};

#[derive(clap::Args, Debug)]
pub struct Args {
    #[command(flatten)]
    bake: BakeArgs,
}

pub fn run(args: &Args) -> Result<()> {
    let scene = args.bake.load()?.scene;
    say(&SceneCheck::new(&scene).to_string());
    Ok(())
}
