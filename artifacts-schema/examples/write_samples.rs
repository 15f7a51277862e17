//! Writes one small artifact of each kind into a folder, for readers in other languages to open:
//! `cargo run --release -p artifacts-schema --example write_samples -- FOLDER`.

#[path = "../tests/artifacts/samples.rs"]
mod samples;

fn main() -> Result<(), artifacts_schema::SchemaError> {
    let folder = std::env::args()
        .nth(1)
        .unwrap_or_else(|| "samples".to_owned());
    samples::write_all(folder.as_ref(), &samples::provenance())
}
