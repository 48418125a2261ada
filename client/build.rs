//! Compiles the drive log's messages without a system protoc; nothing without the feature `mcap`.

use std::error::Error;

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo:rerun-if-changed=proto");
    #[cfg(feature = "mcap")]
    compile()?;
    Ok(())
}

#[cfg(feature = "mcap")]
fn compile() -> Result<(), Box<dyn Error>> {
    use prost::Message;

    const FILES: [&str; 2] = ["echofix/log/v1/drive.proto", "foxglove/location_fix.proto"];
    let descriptors = protox::compile(FILES, ["proto"])?;
    let out = std::path::PathBuf::from(std::env::var("OUT_DIR")?).join("drivelog.bin");
    std::fs::write(out, descriptors.encode_to_vec())?;
    tonic_prost_build::configure().compile_fds(descriptors)?;
    Ok(())
}
