//! The command `luxel`.

fn main() {
    println!("luxel {}", env!("CARGO_PKG_VERSION"));
}
