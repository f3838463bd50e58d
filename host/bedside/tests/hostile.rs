//! Hostile pages and hostile input: refused, counted, and nobody else notices.

mod rig;

use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use bedside::hub::now_ms;
use bedside::server::{Options, Server, ServerError};
use bedside::source::Watch;
use plant::bench::BenchConfig;
use rig::{LONG, Page, get, samples};
use serde_json::{Value, json};
use tokio_tungstenite::tungstenite::Message;

/// The line that counts refused connections.
const CROWDED: &str = "eupnea_refused_total{reason=\"crowded\"} ";

fn serve(listen: &str) -> Server {
    let watch = Watch::bench("R20C20", &BenchConfig::paper(20.0, 20.0)).unwrap();
    let listen = listen.parse().unwrap();
    Server::start(vec![watch], &Options { listen, steer: false, demo: false, folder: std::env::temp_dir() })
        .unwrap()
}

fn local() -> Server {
    serve("127.0.0.1:0")
}

/// Waits until this many refusals for a reason are counted.
fn refused(server: &Server, reason: &str, count: usize) {
    let deadline = Instant::now() + LONG;
    let line = format!("eupnea_refused_total{{reason=\"{reason}\"}} {count}\n");
    while !get(server, "/metrics", &[]).2.contains(&line) {
        assert!(Instant::now() < deadline, "{}", get(server, "/metrics", &[]).2);
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn a_page_of_another_site_is_refused() {
    let server = local();
    for origin in ["http://evil.example", "null", "https://127.0.0.1"] {
        assert_eq!(Page::with_headers(&server, &[("origin", origin)]).err(), Some(403), "{origin}");
    }
    let (status, headers, text) = get(&server, "/api/state", &[("origin", "http://evil.example")]);
    assert_eq!((status, text.as_str()), (403, "refused: only a page of this server may use it"));
    assert!(headers.contains("content-security-policy"), "also on a refusal");
    refused(&server, "origin", 4);
}

#[test]
fn a_name_that_was_pointed_at_this_computer_is_refused() {
    let server = local();
    let port = server.address().port();
    let evil = format!("evil.example:{port}");
    for path in ["/", "/api/state", "/metrics", "/api/stream"] {
        let (status, _, text) = get(&server, path, &[("host", &evil)]);
        assert_eq!(status, 403, "{path}");
        assert!(text.contains("open this page by the address"), "{text}");
    }
    let origin = format!("http://{evil}");
    assert_eq!(Page::with_headers(&server, &[("host", &evil), ("origin", &origin)]).err(), Some(403));
    refused(&server, "host", 5);
    let own = format!("localhost:{port}");
    assert_eq!(get(&server, "/", &[("host", &own)]).0, 200);
}

/// Reads a page's samples until some have come to the server after this time, ms since 1970; none may be missing after `next`.
fn samples_after(page: &mut Page, time_ms: u64, next: &mut Option<u64>) {
    let deadline = Instant::now() + LONG;
    loop {
        let frame = samples(&page.next_binary());
        assert!(next.is_none_or(|next| next == frame.tick) && frame.dropped == 0, "samples are missing");
        *next = Some(frame.tick + frame.phases.len() as u64);
        if frame.time_ms > time_ms {
            return;
        }
        assert!(Instant::now() < deadline, "the device no longer ventilates");
    }
}

#[test]
fn a_flood_closes_its_page_and_no_other_and_ventilation_goes_on() {
    let watch = Watch::bench("R20C20", &BenchConfig::paper(20.0, 20.0)).unwrap();
    let listen = "127.0.0.1:0".parse().unwrap();
    let options = Options { listen, steer: true, demo: false, folder: std::env::temp_dir() };
    let server = Server::start(vec![watch], &options).unwrap();
    let mut other = Page::steering(&server);
    other.ventilate(0);
    let (mut flood, mut next) = (Page::open(&server), None);
    let began = now_ms();
    let flooding = std::thread::spawn(move || {
        let deadline = Instant::now() + LONG;
        while flood.send_raw(Message::text(r#"{"type":"watch","devices":[0]}"#)).is_ok() {
            assert!(Instant::now() < deadline, "the server reads all of it");
        }
        flood.closed();
        now_ms()
    });
    samples_after(&mut other, began, &mut next);
    let closed = flooding.join().unwrap();
    refused(&server, "flood", 1);
    // Not what came before: that waits in the socket.
    samples_after(&mut other, closed, &mut next);
    other.send(&json!({"type": "mark", "id": 99, "device": 0, "text": "here"}));
    let marked = other.text(|message| message["type"] == "event" && message["kind"] == "marker");
    assert!(marked["time_ms"].as_u64().unwrap() >= closed, "{marked}");
    samples_after(&mut other, marked["time_ms"].as_u64().unwrap(), &mut None);
    other.state(0, |state| state["ventilating"] == true);
}

#[test]
fn unreadable_messages_are_answered_and_ten_of_them_close_the_page() {
    let server = local();
    let mut page = Page::open(&server);
    let malformed = |text: &str| Message::text(text.to_owned());
    for message in [
        malformed("{"),
        malformed("[1,2]"),
        malformed(r#"{"type":"start","device":999,"id":1}"#),
        malformed(r#"{"type":"format_disk"}"#),
        Message::binary(vec![1, 2, 3]),
    ] {
        page.send_raw(message).unwrap();
        let answer = page.text(|message| message["type"] == "answer");
        assert_eq!((&answer["id"], &answer["ok"]), (&Value::Null, &json!(false)));
    }
    refused(&server, "malformed", 5);
    for _ in 0..5 {
        page.send_raw(malformed("nonsense")).unwrap();
    }
    assert_eq!(page.closed(), Some(1008));
}

#[test]
fn a_message_that_is_too_long_closes_its_page() {
    let server = local();
    let mut page = Page::open(&server);
    let _ =
        page.send_raw(Message::text(format!("{{\"type\":\"token\",\"token\":\"{}\"}}", "0".repeat(5000))));
    page.closed();
    refused(&server, "malformed", 1);
}

#[test]
fn a_device_that_does_not_exist_is_refused() {
    let server = local();
    let mut page = Page::open(&server);
    let answer = page.ask(json!({"type": "start", "device": 7}));
    assert_eq!((&answer["ok"], &answer["text"]), (&json!(false), &json!("there is no such device")));
}

#[test]
fn from_other_computers_even_reading_needs_the_token() {
    let server = serve("0.0.0.0:0");
    assert!(
        server.url().starts_with("http://127.0.0.1:"),
        "an address that a browser can open: {}",
        server.url()
    );
    let address = format!("127.0.0.1:{}", server.address().port());
    let host = [("host", address.as_str())];
    assert_eq!((get(&server, "/", &host).0, get(&server, "/app.js", &host).0), (200, 200));
    for path in ["/api/state", "/metrics"] {
        assert_eq!(get(&server, path, &host).0, 403, "{path}");
        let token = format!("Bearer {}", server.token().unwrap());
        assert_eq!(get(&server, path, &[host[0], ("authorization", &token)]).0, 200, "{path}");
    }
    let mut wrong = Page::with_headers(&server, &host).unwrap();
    wrong.send(&json!({"type": "token", "token": "guess"}));
    assert_eq!(wrong.closed(), Some(1008));
    let mut right = Page::with_headers(&server, &host).unwrap();
    right.send(&json!({"type": "token", "token": server.token().unwrap()}));
    assert_eq!(right.next_text()["type"], "hello");
}

#[test]
fn there_are_not_more_pages_than_the_server_feeds() {
    let server = local();
    let pages: Vec<Page> = (0..bedside::viewers::VIEWERS_MAX)
        .map(|_| {
            let mut page = Page::open(&server);
            page.state(0, |_| true);
            page
        })
        .collect();
    assert_eq!(Page::with_headers(&server, &[]).err(), Some(503));
    drop(pages);
    let deadline = Instant::now() + LONG;
    while Page::with_headers(&server, &[]).is_err() {
        assert!(Instant::now() < deadline, "closed pages make room");
    }
}

/// Sends bytes and reads until the server closes the connection.
fn talk(server: &Server, text: &str) -> String {
    let mut stream = TcpStream::connect(server.address()).unwrap();
    stream.set_read_timeout(Some(LONG)).unwrap();
    stream.write_all(text.as_bytes()).unwrap();
    let mut response = String::new();
    let _ = stream.read_to_string(&mut response);
    response
}

#[test]
fn a_request_that_never_ends_is_cut_off() {
    let server = local();
    let before = Instant::now();
    let response = talk(&server, "GET / HTTP/1.1\r\nhost: ");
    assert!(!response.contains("200 OK"), "{response}");
    assert!(before.elapsed() < LONG, "the server has closed it, not the test");
}

#[test]
fn there_are_not_more_connections_than_the_server_holds() {
    let server = local();
    // They send nothing, and would otherwise take one file each.
    let idle: Vec<TcpStream> = (0..2 * bedside::http::CONNECTIONS_MAX)
        .map(|_| TcpStream::connect(server.address()).unwrap())
        .collect();
    let closed = |stream: &TcpStream| {
        stream.set_nonblocking(true).unwrap();
        matches!((&*stream).read(&mut [0]), Ok(0) | Err(_))
            && !matches!((&*stream).read(&mut [0]), Err(error) if error.kind() == ErrorKind::WouldBlock)
    };
    let deadline = Instant::now() + LONG;
    while idle.iter().filter(|stream| closed(stream)).count() < bedside::http::CONNECTIONS_MAX {
        assert!(Instant::now() < deadline, "too many connections stay open");
        std::thread::sleep(Duration::from_millis(10));
    }
    drop(idle);
    let own = server.address().to_string();
    let request = format!("GET /metrics HTTP/1.1\r\nhost: {own}\r\nconnection: close\r\n\r\n");
    let counted = |text: &str| {
        text.lines().any(|line| {
            line.strip_prefix(CROWDED)
                .is_some_and(|count| count.parse::<u32>().unwrap() >= bedside::http::CONNECTIONS_MAX as u32)
        })
    };
    while !counted(&talk(&server, &request)) {
        assert!(Instant::now() < deadline, "there is room again, and the refusals are counted");
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn another_site_cannot_load_anything_from_here() {
    let server = local();
    for path in ["/metrics", "/api/state", "/app.js", "/"] {
        let (status, headers, _) =
            get(&server, path, &[("sec-fetch-site", "cross-site"), ("sec-fetch-mode", "no-cors")]);
        assert_eq!(status, 403, "{path}");
        assert!(headers.contains("cross-origin-resource-policy: same-origin"), "{headers}");
    }
    refused(&server, "cross_site", 4);
    let link = [("sec-fetch-site", "cross-site"), ("sec-fetch-mode", "navigate")];
    assert_eq!(get(&server, "/", &link).0, 200, "a link to the page");
}

#[test]
fn the_server_listens_at_an_address_of_ipv6() {
    let listen = "[::1]:0".parse().unwrap();
    let options = Options { listen, steer: false, demo: false, folder: std::env::temp_dir() };
    let watch = Watch::bench("R20C20", &BenchConfig::paper(20.0, 20.0)).unwrap();
    let server = match Server::start(vec![watch], &options) {
        Ok(server) => server,
        Err(ServerError::Listen(_, reason)) if reason.kind() == ErrorKind::AddrNotAvailable => {
            eprintln!("skipped: this computer has no IPv6");
            return;
        }
        Err(other) => panic!("{other}"),
    };
    assert!(server.url().starts_with("http://[::1]:"), "{}", server.url());
    assert_eq!(get(&server, "/", &[]).0, 200);
    let evil = format!("[::2]:{}", server.address().port());
    assert_eq!(get(&server, "/", &[("host", &evil)]).0, 403);
    let mut page = Page::open(&server);
    assert_eq!(page.next_text()["type"], "hello");
}

#[test]
fn a_page_that_vanishes_gives_the_wheel_back() {
    let watch = Watch::bench("R20C20", &BenchConfig::paper(20.0, 20.0)).unwrap();
    let listen = "127.0.0.1:0".parse().unwrap();
    let options = Options { listen, steer: true, demo: false, folder: std::env::temp_dir() };
    let server = Server::start(vec![watch], &options).unwrap();
    let mut gone = Page::steering(&server);
    gone.send(&json!({"type": "take", "device": 0}));
    gone.text(|message| message["type"] == "steerer" && message["yours"] == true);
    let mut other = Page::steering(&server);
    // From here on nobody reads the first page's socket, as if its computer were asleep: it answers no ping.
    other.text(|message| message["type"] == "steerer" && message["who"].is_string());
    other.text(|message| message["type"] == "steerer" && message["who"] == Value::Null);
    drop(gone);
}
