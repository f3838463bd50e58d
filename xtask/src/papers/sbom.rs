//! The list of a program's parts for machines: `CycloneDX` 1.6 in JSON, <https://cyclonedx.org/docs/1.6/json/>.

use anyhow::Result;
use serde_json::{Value, json, to_string_pretty};
use xshell::Shell;

use super::results::time;
use super::software::{self, Id, Part, Program};

/// Files of the lists of chip and host.
pub const FILES: [&str; 2] = ["sbom-chip.cdx.json", "sbom-host.cdx.json"];

/// The lists of chip and host, with their files, for a revision and its time in seconds since 1970.
pub fn lists(shell: &Shell, revision: &str, time_s: u64) -> Result<[(&'static str, String); 2]> {
    let list = |program: &Program| to_string_pretty(&sbom(program, revision, &time(time_s)));
    let [chip, host] = FILES;
    Ok([(chip, list(&software::chip(shell)?)? + "\n"), (host, list(&software::host(shell)?)? + "\n")])
}

/// The list, at a time as in 2026-11-29T00:00:00Z.
fn sbom(program: &Program, revision: &str, time: &str) -> Value {
    let own = program.own();
    let component = own.map(|(id, part)| component(program.kind, id, part)).unwrap_or_default();
    let others = program.parts.iter().filter(|(id, _)| own.is_none_or(|(own, _)| own != *id));
    let components: Vec<_> = others.map(|(id, part)| self::component("library", id, part)).collect();
    let dependencies: Vec<_> = program
        .parts
        .iter()
        .map(|(id, part)| {
            let uses: Vec<_> = part.uses.iter().map(|used| reference(used, &program.parts[used])).collect();
            json!({"ref": reference(id, part), "dependsOn": uses})
        })
        .collect();
    json!({
        "$schema": "http://cyclonedx.org/schema/bom-1.6.schema.json",
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {
            "timestamp": time,
            "component": component,
            "properties": [{"name": "eupnea:revision", "value": revision}],
        },
        "components": components,
        "dependencies": dependencies,
    })
}

/// The part's package URL or, for the project's own, name and version.
fn reference((name, version): &Id, part: &Part) -> String {
    match part.registry {
        Some(registry) => format!("pkg:{registry}/{}@{version}", name.replace('@', "%40")),
        None => format!("{name}@{version}"),
    }
}

fn component(kind: &str, id: &Id, part: &Part) -> Value {
    let reference = reference(id, part);
    let mut component = json!({
        "type": kind,
        "bom-ref": reference,
        "name": id.0,
        "version": id.1,
        "description": part.description,
        "licenses": [{"expression": part.licence}],
    });
    if part.registry.is_some() {
        component["purl"] = reference.into();
    }
    if let Some((algorithm, checksum)) = &part.checksum {
        component["hashes"] = json!([{"alg": algorithm, "content": checksum}]);
    }
    component
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_part_is_listed_with_its_licence_and_checksum_and_what_it_uses() {
        let id = |name: &str| (name.to_owned(), "1.0.0".to_owned());
        let own = Part { uses: [id("crc")].into(), licence: "MIT".into(), ..Part::default() };
        let checksum = Some(("SHA-256", "6a02".to_owned()));
        let crc = Part {
            licence: "MIT OR Apache-2.0".into(),
            registry: Some("cargo"),
            checksum,
            ..Part::default()
        };
        let parts = [(id("firmware"), own), (id("crc"), crc)].into();
        let list =
            sbom(&Program { name: "firmware", kind: "firmware", parts }, "abc", "2026-11-29T00:00:00Z");
        assert_eq!(list["metadata"]["component"]["type"], "firmware");
        let listed = &list["components"];
        assert_eq!(listed.as_array().map(Vec::len), Some(1));
        assert_eq!(listed[0]["purl"], "pkg:cargo/crc@1.0.0");
        assert_eq!(listed[0]["licenses"][0]["expression"], "MIT OR Apache-2.0");
        assert_eq!(listed[0]["hashes"][0]["content"], "6a02");
        let uses = json!({"ref": "firmware@1.0.0", "dependsOn": ["pkg:cargo/crc@1.0.0"]});
        assert!(list["dependencies"].as_array().unwrap().contains(&uses));
    }
}
