//! `trainer serve` as a process: it prints its address, answers there, and ends with Ctrl-C.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};

use super::support::{Place, text};

/// Starts a server; returns it with the address that it prints.
fn serve(place: &Place, line: &str) -> (Child, String) {
    let mut command = place.command(&format!("serve --listen 127.0.0.1:0 {line}"));
    let mut child =
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut address = String::new();
    BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut address).unwrap();
    (child, address.trim().to_owned())
}

/// The response to a request for a path at `http://HOST/`.
fn get(address: &str, path: &str) -> String {
    let host = address.strip_prefix("http://").unwrap().split('/').next().unwrap();
    let mut stream = TcpStream::connect(host).unwrap();
    write!(stream, "GET {path} HTTP/1.1\r\nhost: {host}\r\nconnection: close\r\n\r\n").unwrap();
    let mut response = String::new();
    stream.read_to_string(&mut response).unwrap();
    response
}

fn interrupt(child: Child) -> Option<i32> {
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    assert!(
        text(&output.stderr).contains("devices at a port keep running, simulated ones end"),
        "{}",
        text(&output.stderr)
    );
    output.status.code()
}

#[test]
fn it_prints_its_address_answers_there_and_ends_with_ctrl_c() {
    let place = Place::new();
    let (child, address) = serve(&place, "--bench R20C20 --bench R5C50");
    assert!(!address.contains('#'), "nobody may steer");
    let state = get(&address, "/api/state");
    assert!(state.contains("\"name\":\"R20C20\"") && state.contains("\"name\":\"R5C50\""), "{state}");
    assert!(get(&address, "/").contains("<html"));
    assert_eq!(interrupt(child), Some(130));
}

#[test]
fn a_recording_is_replayed() {
    let place = Place::new();
    let data = place.collected();
    let (child, address) = serve(&place, &format!("--recording {data} --steer"));
    assert!(address.contains("/#token="), "{address}");
    assert!(get(&address, "/api/state").contains("\"kind\":\"recording\""));
    interrupt(child);
}

#[test]
fn what_cannot_be_shown_is_refused_with_a_way_out() {
    let place = Place::new();
    for (line, expected) in [
        ("serve", "name a device with --port or --bench"),
        ("serve --bench R20", "or name a TOML file"),
        ("serve --recording missing.parquet", "missing.parquet"),
        ("serve --recording missing.json", "cannot read missing.json"),
        ("serve --listen 192.0.2.1:8080 --bench R20C20", "choose another address with --listen"),
    ] {
        let refused = place.refused(line);
        assert!(refused.contains(expected), "{line}: {refused}");
    }
}
