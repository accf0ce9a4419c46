//! Finds the native libraries, compiles `ffi/`, and tells the crate which build it is; decides nothing else.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::exit;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=ffi");
    identity();
    if feature("embree") {
        embree();
    }
    if feature("openexr") {
        openexr();
    }
    #[cfg(feature = "regenerate-bindings")]
    {
        bind("embree", "Luxel(Embree|Rays|Hit).*", "luxel_embree_.*");
        bind("openexr", "LuxelExr.*", "luxel_exr_.*");
    }
}

fn feature(name: &str) -> bool {
    std::env::var_os(format!("CARGO_FEATURE_{}", name.to_uppercase())).is_some()
}

/// What `BuildId` says of this build: a hash of all that is compiled, the compiler, the target.
fn identity() {
    let mut hash = 0xcbf2_9ce4_8422_2325;
    let mut left: Vec<PathBuf> = ["Cargo.toml", "Cargo.lock", "build.rs", "ffi", "src"].map(PathBuf::from).into();
    while let Some(path) = left.pop() {
        println!("cargo::rerun-if-changed={}", path.display());
        let mut inner: Vec<PathBuf> = fs::read_dir(&path).into_iter().flatten().flatten().map(|e| e.path()).collect();
        inner.sort();
        // A folder has no content; a lock file may be missing.
        let content = fs::read(&path).unwrap_or_default();
        // FNV-1a.
        for &byte in path.to_string_lossy().as_bytes().iter().chain(&content) {
            hash = (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
        left.extend(inner);
    }
    let rustc = std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let version = std::process::Command::new(rustc).arg("--version").output();
    let version = version.map(|output| String::from_utf8_lossy(&output.stdout).trim().to_owned()).unwrap_or_default();
    println!("cargo::rustc-env=LUXEL_SOURCE={hash:016x}");
    println!("cargo::rustc-env=LUXEL_COMPILER={version}");
    println!("cargo::rustc-env=LUXEL_TARGET={}", std::env::var("TARGET").unwrap_or_default());
}

/// Embree 4, else Embree 3. Debian ships no `.pc` file for either, so the default folders are searched too.
fn embree() {
    let mut folders = Vec::new();
    let found = ["4", "3"].into_iter().find(|version| {
        let package = format!("embree{version}");
        let probed = pkg_config::Config::new().cargo_metadata(false).probe(&package);
        if let Ok(library) = probed {
            folders = library.include_paths;
            print_search_paths(&library.link_paths);
            return true;
        }
        default_include(&format!("embree{version}/rtcore.h")) && default_library(&format!("libembree{version}.so"))
    });
    let Some(version) = found else {
        missing("Embree 3 or 4", "libembree-dev", "openexr");
    };
    // The shim prefers the newer header by itself; the macro keeps header and library of one version.
    compile("embree", &folders, &[("LUXEL_EMBREE_VERSION", version)]);
    println!("cargo::rustc-link-lib=dylib=embree{version}");
}

/// OpenEXRCore, the C library of OpenEXR 3.1 and later.
fn openexr() {
    let probed = pkg_config::Config::new().cargo_metadata(false).atleast_version("3.1").probe("OpenEXR");
    let Ok(library) = probed else {
        missing("OpenEXR 3.1 or later", "libopenexr-dev", "embree");
    };
    // Of the libraries that the .pc file lists only the C one is needed; its name carries the version.
    let Some(core) = library.libs.iter().find(|name| name.starts_with("OpenEXRCore")) else {
        missing("OpenEXRCore", "libopenexr-dev", "embree");
    };
    compile("openexr", &library.include_paths, &[]);
    print_search_paths(&library.link_paths);
    println!("cargo::rustc-link-lib=dylib={core}");
}

/// Compiled for the baseline processor, so that the binary runs anywhere (Embree picks its kernels at run time), and
/// without contraction to fused multiply-add, so that it computes the same bits everywhere.
fn compile(name: &str, include: &[PathBuf], defines: &[(&str, &str)]) {
    let mut build = cc::Build::new();
    build.file(format!("ffi/{name}_shim.c")).includes(include).std("c11");
    build.opt_level(3).flag("-ffp-contract=off").warnings(true).extra_warnings(true);
    for (key, value) in defines {
        build.define(key, *value);
    }
    build.compile(&format!("luxel_{name}_shim"));
}

fn print_search_paths(paths: &[PathBuf]) {
    for path in paths {
        println!("cargo::rustc-link-search=native={}", path.display());
    }
}

fn default_include(header: &str) -> bool {
    ["/usr/include", "/usr/local/include"].iter().any(|folder| Path::new(folder).join(header).exists())
}

/// Whether the linker finds `file` where Debian (or a local installation) puts it.
fn default_library(file: &str) -> bool {
    let arch = std::env::var("CARGO_CFG_TARGET_ARCH").unwrap_or_default();
    let multiarch = format!("/usr/lib/{arch}-linux-gnu");
    let folders = [multiarch.as_str(), "/usr/lib", "/usr/lib64", "/usr/local/lib", "/usr/local/lib64"];
    let folder = folders.iter().find(|folder| Path::new(folder).join(file).exists());
    if let Some(folder) = folder {
        println!("cargo::rustc-link-search=native={folder}");
    }
    folder.is_some()
}

/// Stops the build with one message that says what to do; `other` is the feature that need not be given up.
fn missing(library: &str, package: &str, other: &str) -> ! {
    println!(
        "cargo::error={library} was not found: install it (Debian: apt install {package}), or build without it \
         (cargo build --no-default-features --features {other}; without either native library: --no-default-features)"
    );
    // Cargo fails by the message; with another code it would print this program's whole output besides.
    exit(0);
}

/// Rewrites `ffi/NAME_bindings.rs` from `ffi/NAME_shim.h`.
#[cfg(feature = "regenerate-bindings")]
fn bind(name: &str, types: &str, functions: &str) {
    let header = format!("ffi/{name}_shim.h");
    let written = bindgen::Builder::default()
        .header(&header)
        .allowlist_type(types)
        .allowlist_function(functions)
        .allowlist_var("LUXEL_.*")
        .generate_comments(false)
        .rust_edition(bindgen::RustEdition::Edition2024)
        .rust_edition(bindgen::RustEdition::Edition2024)
        .generate()
        .map_err(|e| e.to_string())
        .and_then(|bindings| bindings.write_to_file(format!("ffi/{name}_bindings.rs")).map_err(|e| e.to_string()));
    if let Err(error) = written {
        println!("cargo::error={header}: {error}");
        exit(1);
    }
}
