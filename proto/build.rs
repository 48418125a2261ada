//! Compiles the contract without a system protoc.

use std::error::Error;
use std::path::PathBuf;

use prost::Message;

const FILES: [&str; 5] = [
    "echofix/v1/geometry.proto",
    "echofix/v1/radar.proto",
    "echofix/v1/mapping.proto",
    "echofix/v1/localization.proto",
    "echofix/v1/map.proto",
];

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo:rerun-if-changed=echofix");
    println!("cargo:rerun-if-changed=third_party");
    let descriptors = protox::compile(FILES, [".", "third_party"])?;
    let out = PathBuf::from(std::env::var("OUT_DIR")?).join("echofix.v1.bin");
    std::fs::write(out, descriptors.encode_to_vec())?;
    tonic_prost_build::configure()
        .codec_path("crate::codec::SliceCodec")
        .extern_path(".google.rpc.Status", "::tonic_types::pb::Status")
        .compile_fds(descriptors)?;
    Ok(())
}
