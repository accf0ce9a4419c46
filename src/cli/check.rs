//! `luxel check`.

use luxel::Result;

use super::{args::BakeArgs, say};

#[derive(clap::Args, Debug)]
pub struct Args {
    #[command(flatten)]
    bake: BakeArgs,
}

pub fn run(args: &Args) -> Result<()> {
    let scene = args.bake.load()?.scene;
    say(&format!("{}: {} triangles\n", scene.name, scene.triangles.len()));
    Ok(())
}
