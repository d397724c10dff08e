//! Makes the messages of a recording, and the schemas that it holds, from `proto/`.

use std::path::PathBuf;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let out = PathBuf::from(std::env::var("OUT_DIR")?);
    for package in ["wcal", "foxglove"] {
        let file = format!("proto/{package}.proto");
        println!("cargo::rerun-if-changed={file}");
        let all = protox::compile([&file], ["proto"])?;
        std::fs::write(
            out.join(format!("{package}.bin")),
            prost::Message::encode_to_vec(&all),
        )?;
        prost_build::Config::new()
            .enable_type_names()
            .compile_fds(all)?;
    }
    Ok(())
}
