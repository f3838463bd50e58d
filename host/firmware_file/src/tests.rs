//! A release file is read as it was written, and whatever else is refused by name.

use std::collections::BTreeMap;
use std::io::{Cursor, Write as _};

use proptest::prelude::*;
use zip::ZipWriter;
use zip::write::SimpleFileOptions;

use crate::*;

fn pair() -> KeyPair {
    KeyPair::from_seed(Seed::new([42; 32]))
}

fn key() -> ReleaseKey {
    ReleaseKey::of(&pair())
}

fn files() -> BTreeMap<String, Vec<u8>> {
    [("stm32f405.bin", &[1; 1000][..]), ("stm32f405.elf", b"elf"), ("weights.bin", &[2; 100])]
        .map(|(name, content)| (name.to_owned(), content.to_vec()))
        .into()
}

fn part(content: Content, file: &str, address: u32, bytes: u32) -> Part {
    Part { content, file: file.into(), address, bytes }
}

fn firmware() -> Firmware {
    Firmware {
        version: "0.1.0".into(),
        revision: "a79337ed".into(),
        board: "stm32f405".into(),
        chip: "STM32F405RG".into(),
        image: "The main board".into(),
        usb_dfu: true,
        parts: vec![
            part(Content::Program, "stm32f405.bin", 0x0800_0000, 1000),
            part(Content::Weights, "weights.bin", 0x080C_0000, 100),
        ],
    }
}

fn release() -> Vec<u8> {
    write(&firmware(), &files(), &pair()).unwrap()
}

/// Entries of a release file, which a test changes.
fn entries() -> BTreeMap<String, Vec<u8>> {
    let mut archive = zip::ZipArchive::new(Cursor::new(release())).unwrap();
    let names: Vec<String> = archive.file_names().map(str::to_owned).collect();
    let content = |name: String| {
        let mut content = Vec::new();
        std::io::copy(&mut archive.by_name(&name).unwrap(), &mut content).unwrap();
        (name, content)
    };
    names.into_iter().map(content).collect()
}

fn archive(entries: &BTreeMap<String, Vec<u8>>) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, content) in entries {
        zip.start_file(name.as_str(), SimpleFileOptions::default()).unwrap();
        zip.write_all(content).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

/// What a reader says of a release file with changed entries.
fn refusal(change: impl FnOnce(&mut BTreeMap<String, Vec<u8>>)) -> PackageError {
    let mut entries = entries();
    change(&mut entries);
    read(&archive(&entries), &key()).unwrap_err()
}

/// The same with a manifest that the trusted key has signed.
fn refusal_of_manifest(change: impl FnOnce(&str) -> String) -> PackageError {
    refusal(|entries| {
        let text = change(std::str::from_utf8(&entries[MANIFEST]).unwrap());
        entries.insert(SIGNATURE.into(), seal(text.as_bytes(), &pair()).into());
        entries.insert(MANIFEST.into(), text.into());
    })
}

#[test]
fn a_release_file_is_read_as_it_was_written() {
    let package = read(&release(), &key()).unwrap();
    assert_eq!(package.files, files());
    assert_eq!(package.manifest.firmware, firmware());
    let parts: Vec<_> = package.parts().map(|(part, bytes)| (part.address, bytes.len())).collect();
    assert_eq!(parts, [(0x0800_0000, 1000), (0x080C_0000, 100)]);
}

#[test]
fn the_same_input_gives_the_same_bytes() {
    assert_eq!(release(), release());
    let mut archive = zip::ZipArchive::new(Cursor::new(release())).unwrap();
    let names: Vec<String> = archive.file_names().map(str::to_owned).collect();
    assert_eq!(names, [MANIFEST, SIGNATURE, "stm32f405.bin", "stm32f405.elf", "weights.bin"]);
    for index in 0..names.len() {
        let entry = archive.by_index(index).unwrap();
        assert_eq!(entry.last_modified().unwrap().year(), 1980, "no time of the machine");
        assert_eq!(entry.unix_mode().unwrap() & 0o777, 0o644);
    }
}

#[test]
fn what_is_no_release_file_is_refused() {
    assert_eq!(read(b"no archive", &key()), Err(PackageError::NotZip));
    assert_eq!(refusal(|entries| drop(entries.remove(MANIFEST))), PackageError::NoManifest);
    assert_eq!(refusal(|entries| drop(entries.remove(SIGNATURE))), PackageError::Unsigned);
}

#[test]
fn another_signature_is_refused() {
    let other = KeyPair::from_seed(Seed::new([43; 32]));
    let trusted = ReleaseKey::of(&other);
    assert_eq!(read(&release(), &trusted), Err(PackageError::OtherKey { by: key(), trusted }));
    let forged = refusal(|entries| {
        let seal = seal(&entries[MANIFEST], &other);
        entries.insert(SIGNATURE.into(), seal.replace(&trusted.to_string(), &key().to_string()).into());
    });
    assert_eq!(forged, PackageError::ManifestDamaged);
    let no_seal = refusal(|entries| drop(entries.insert(SIGNATURE.into(), b"signed".to_vec())));
    assert_eq!(no_seal, PackageError::Damaged(SIGNATURE.into()));
}

#[test]
fn a_changed_manifest_is_refused() {
    let changed = refusal(|entries| entries.get_mut(MANIFEST).unwrap().push(b' '));
    assert_eq!(changed, PackageError::ManifestDamaged);
    assert!(matches!(refusal_of_manifest(|_| "{}".into()), PackageError::ManifestFormat(_)));
    let newer = refusal_of_manifest(|_| r#"{"format":2,"firmware":"of a later format"}"#.into());
    assert_eq!(newer, PackageError::Newer(2));
}

#[test]
fn a_damaged_missing_or_additional_file_is_named() {
    let name = || "weights.bin".to_owned();
    assert_eq!(refusal(|entries| entries.get_mut(&name()).unwrap()[0] ^= 1), PackageError::Damaged(name()));
    assert_eq!(refusal(|entries| entries.get_mut(&name()).unwrap().push(2)), PackageError::Damaged(name()));
    assert_eq!(refusal(|entries| drop(entries.remove(&name()))), PackageError::Missing(name()));
    let more = refusal(|entries| drop(entries.insert("more.bin".into(), vec![1])));
    assert_eq!(more, PackageError::Extra("more.bin".into()));
}

#[test]
fn an_entry_that_unpacks_to_more_than_any_firmware_is_refused() {
    let bomb = |name: &'static str, bytes: u64| {
        refusal(|entries| drop(entries.insert(name.into(), vec![0; bytes as usize + 1])))
    };
    assert_eq!(bomb("weights.bin", FILE_LIMIT), PackageError::TooLarge("weights.bin".into()));
    assert_eq!(bomb(MANIFEST, MANIFEST_LIMIT), PackageError::TooLarge(MANIFEST.into()));
}

#[test]
fn parts_must_be_whole_files_that_do_not_overlap() {
    let written = |parts| write(&Firmware { parts, ..firmware() }, &files(), &pair());
    let weights = |address, bytes| vec![part(Content::Weights, "weights.bin", address, bytes)];
    assert_eq!(written(weights(0, 99)), Err(PackageError::Part("weights.bin".into())));
    assert_eq!(written(weights(u32::MAX, 100)), Err(PackageError::Part("weights.bin".into())));
    let twice = [weights(0, 100), weights(99, 100)].concat();
    assert_eq!(written(twice), Err(PackageError::Part("weights.bin".into())));
    let other = vec![part(Content::Program, "none.bin", 0, 1)];
    assert_eq!(written(other), Err(PackageError::Missing("none.bin".into())));
    let read = refusal_of_manifest(|text| text.replace(r#""bytes": 100,"#, r#""bytes": 99,"#));
    assert_eq!(read, PackageError::Part("weights.bin".into()));
}

#[test]
fn a_file_with_the_name_of_the_manifest_is_not_written() {
    let mut files = files();
    files.insert(MANIFEST.into(), vec![]);
    assert_eq!(write(&firmware(), &files, &pair()), Err(PackageError::Extra(MANIFEST.into())));
}

#[test]
fn an_image_for_the_desk_has_the_chip_of_its_board() {
    let chips = ["stm32f405", "stm32f446-desk", "stm32f405-bench", ""].map(chip_of);
    assert_eq!(chips, [Some("STM32F405RG"), Some("STM32F446RETx"), None, None]);
}

#[test]
fn a_key_has_64_hexadecimal_digits() {
    let text = key().to_string();
    assert_eq!(text.parse(), Ok(key()));
    assert_eq!(format!("{text}\n").parse(), Ok(key()));
    for wrong in ["", "é", &text[1..], &text.replace('1', "g"), &text.replacen(&text[..2], "+1", 1)] {
        assert_eq!(wrong.parse::<ReleaseKey>(), Err(KeyError), "{wrong}");
    }
}

proptest! {
    #[test]
    fn a_damaged_archive_is_refused_or_has_the_same_content(at: prop::sample::Index, change in 1..=u8::MAX) {
        let mut bytes = release();
        let at = at.index(bytes.len());
        prop_assert!(read(&bytes[..at], &key()).is_err());
        bytes[at] ^= change;
        if let Ok(package) = read(&bytes, &key()) {
            prop_assert_eq!(package, read(&release(), &key()).unwrap());
        }
    }

    #[test]
    fn no_bytes_cause_a_panic(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
        prop_assert!(read(&bytes, &key()).is_err());
    }
}
