//! Results as Markdown and as CSV.

use std::fmt::Write;

use super::{
    Entry, Machine, Method, SceneBench,
    sweep::{Configuration, word},
};

/// Tables of all scenes, fastest first; the Pareto front is marked.
pub fn markdown(benches: &[SceneBench], machine: &Machine) -> String {
    let mut text = format!("# Error against time\n\n{machine}\n");
    for bench in benches {
        // Writing to a String cannot fail.
        scene(&mut text, bench).ok();
    }
    text
}

fn scene(text: &mut String, bench: &SceneBench) -> std::fmt::Result {
    let (settings, (paths, noise)) = (&bench.settings, bench.reference);
    writeln!(
        text,
        "\n## {}\n\n{} triangles; {}. Seconds are for the light of {} points, medians; errors are relative root mean \
         squares of luminance at {} random points, in %, against {paths} paths a point ({:.2} %, subtracted).\n",
        bench.name,
        bench.triangles,
        bench.tracers.join(", "),
        settings.job,
        settings.points,
        100.0 * noise,
    )?;
    writeln!(
        text,
        "| front | patches, reconstruction, tracer | grid/rays | patches | bake, s | seconds | total | indirect | bias | 95 % below |"
    )?;
    writeln!(text, "|-|-|-|-|-|-|-|-|-|-|")?;
    for entry in by_time(bench) {
        let Entry { method, seconds, bake_seconds, patches, total, indirect, on_front, .. } = entry;
        let percent = |x: f64| format!("{:.2}", 100.0 * x);
        writeln!(
            text,
            "| {} | {} | {} | {} | {bake_seconds:.3} | {seconds:.3} | {} | {} | {:+.2} | {} |",
            if *on_front { "*" } else { "" },
            method.series(),
            method.label(),
            if *patches > 0 { patches.to_string() } else { String::new() },
            percent(total.rmse),
            percent(indirect.rmse),
            100.0 * total.bias,
            percent(total.p95),
        )?;
    }
    if !bench.left_out.is_empty() {
        writeln!(text, "\nLeft out:\n")?;
    }
    for left in &bench.left_out {
        let method = Method::Bake(left.configuration);
        writeln!(text, "- {}, {}: {}", method.series(), method.label(), left.why)?;
    }
    Ok(())
}

fn by_time(bench: &SceneBench) -> Vec<&Entry> {
    let mut entries: Vec<&Entry> = bench.entries.iter().collect();
    entries.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
    entries
}

/// One line an entry. Errors are fractions.
pub fn csv(benches: &[SceneBench], machine: &Machine) -> String {
    let mut text = String::from(
        "scene,triangles,method,patch_source,grid,rays,reconstruct,backend,paths,patches,runs,bake_seconds,seconds,job,\
         total_rmse,total_bias,total_p95,total_worst,indirect_rmse,indirect_bias,indirect_p95,indirect_worst,\
         reference_noise,on_front,cpu,threads,version,commit\n",
    );
    for bench in benches {
        for entry in &bench.entries {
            let how = match entry.method {
                Method::Bake(Configuration { patches, grid, rays, reconstruct, backend }) => {
                    format!("bake,{},{grid},{rays},{},{},", word(&patches), word(&reconstruct), word(&backend))
                }
                Method::Paths(n) => format!("paths,,,,,,{n}"),
            };
            let difference = |d: &crate::compare::Difference| format!("{},{},{},{}", d.rmse, d.bias, d.p95, d.worst);
            let line = [
                quoted(&bench.name),
                bench.triangles.to_string(),
                how,
                entry.patches.to_string(),
                entry.runs.to_string(),
                entry.bake_seconds.to_string(),
                entry.seconds.to_string(),
                bench.settings.job.to_string(),
                difference(&entry.total),
                difference(&entry.indirect),
                bench.reference.1.to_string(),
                entry.on_front.to_string(),
                quoted(&machine.cpu),
                machine.threads.to_string(),
                machine.version.to_string(),
                quoted(machine.commit.as_deref().unwrap_or_default()),
            ];
            text.push_str(&line.join(","));
            text.push('\n');
        }
    }
    text
}

/// As RFC 4180 has it.
fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.into() }
}
