//! The benches are files of their own: `cargo bench -p needleplan-benches --bench NAME`.
