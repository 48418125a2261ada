//! The definitions that travel with every log.

use prost::Message;
use prost_types::{FileDescriptorProto, FileDescriptorSet};

const DEFINITIONS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/drivelog.bin"));

/// The serialized `FileDescriptorSet` of one file and what it imports, imports first.
pub(super) fn of_file(name: &str) -> Result<Vec<u8>, prost::DecodeError> {
    let all = FileDescriptorSet::decode(DEFINITIONS)?;
    let mut file = Vec::new();
    collect(&all.file, name, &mut file);
    Ok(FileDescriptorSet { file }.encode_to_vec())
}

fn collect(all: &[FileDescriptorProto], name: &str, into: &mut Vec<FileDescriptorProto>) {
    let Some(file) = all.iter().find(|f| f.name() == name) else { return };
    if into.iter().any(|f| f.name() == name) {
        return;
    }
    for import in &file.dependency {
        collect(all, import, into);
    }
    into.push(file.clone());
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_schema_brings_its_imports_and_nothing_else() {
        let names = |file: &str| -> Vec<String> {
            let set = FileDescriptorSet::decode(of_file(file).unwrap().as_slice()).unwrap();
            set.file.iter().map(|f| f.name().to_owned()).collect()
        };
        assert_eq!(names("echofix/log/v1/drive.proto"), ["echofix/log/v1/drive.proto"]);
        let fix = ["google/protobuf/timestamp.proto", "foxglove/location_fix.proto"];
        assert_eq!(names("foxglove/location_fix.proto"), fix);
    }
}
