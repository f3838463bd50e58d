//! Pages and devices for tests. A page here is a WebSocket client that waits at most [`LONG`] for what a test expects.

#![allow(dead_code, reason = "each test file uses its part")]

use std::fmt::Write as _;
use std::io::{Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::time::Duration;

use bedside::server::Server;
use bedside::source::Watch;
use device::port::{Address, Port};
use device::simulated::{MOST_PACE, Served, ServedConfig, Simulated};
use futures_util::{SinkExt, StreamExt};
use plant::bench::BenchConfig;
use serde_json::{Value, json};
use tokio::net::TcpSocket;
use tokio::runtime::{Builder, Runtime};
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::{Error, Message};
use tokio_tungstenite::{WebSocketStream, client_async};

/// Longest time that any step may take.
pub const LONG: Duration = Duration::from_mins(1);

/// An open page.
pub struct Page {
    runtime: Runtime,
    socket: WebSocketStream<tokio::net::TcpStream>,
    requests: u32,
}

impl Page {
    /// Opens a page with these headers, or tells the status of the refusal.
    pub fn with_headers(server: &Server, headers: &[(&'static str, &str)]) -> Result<Self, u16> {
        Self::connect(server.address(), headers, None)
    }

    /// Opens a page as a browser does.
    pub fn open(server: &Server) -> Self {
        let origin = format!("http://{}", server.address());
        Self::with_headers(server, &[("origin", &origin)]).unwrap()
    }

    /// A page with the token.
    pub fn steering(server: &Server) -> Self {
        let mut page = Self::open(server);
        page.send(&json!({"type": "token", "token": server.token().unwrap()}));
        page
    }

    /// A page with a small buffer, which the test does not read.
    pub fn sluggish(server: &Server) -> Self {
        Self::connect(server.address(), &[], Some(4096)).unwrap()
    }

    fn connect(to: SocketAddr, headers: &[(&'static str, &str)], buffer: Option<u32>) -> Result<Self, u16> {
        let runtime = Builder::new_current_thread().enable_all().build().unwrap();
        let mut request = format!("ws://{to}/api/stream").into_client_request().unwrap();
        for (name, value) in headers {
            request.headers_mut().insert(*name, value.parse().unwrap());
        }
        let socket = runtime.block_on(async {
            let socket = if to.is_ipv4() { TcpSocket::new_v4() } else { TcpSocket::new_v6() }.unwrap();
            if let Some(bytes) = buffer {
                socket.set_recv_buffer_size(bytes).unwrap();
            }
            client_async(request, socket.connect(to).await.unwrap()).await
        });
        match socket {
            Ok((socket, _)) => Ok(Self { runtime, socket, requests: 0 }),
            Err(Error::Http(response)) => Err(response.status().as_u16()),
            Err(other) => panic!("{other}"),
        }
    }

    pub fn send(&mut self, message: &Value) {
        self.send_raw(Message::text(message.to_string())).unwrap();
    }

    pub fn send_raw(&mut self, message: Message) -> Result<(), Error> {
        self.runtime.block_on(self.socket.send(message))
    }

    /// The next message; none when the server has closed the page.
    pub fn next(&mut self) -> Option<Message> {
        let next = async { tokio::time::timeout(LONG, self.socket.next()).await };
        let next = self.runtime.block_on(next).expect("the server sends nothing");
        next.and_then(Result::ok)
    }

    pub fn next_text(&mut self) -> Value {
        self.text(|_| true)
    }

    /// The next text that a test waits for.
    pub fn text(&mut self, expected: impl Fn(&Value) -> bool) -> Value {
        let deadline = std::time::Instant::now() + LONG;
        loop {
            assert!(std::time::Instant::now() < deadline, "the message did not come");
            if let Message::Text(text) = self.next().expect("the page is open") {
                let message = serde_json::from_str(&text).unwrap();
                if expected(&message) {
                    return message;
                }
            }
        }
    }

    /// The next state of a device that a test waits for.
    pub fn state(&mut self, device: u8, expected: impl Fn(&Value) -> bool) -> Value {
        self.text(|message| message["type"] == "state" && message["device"] == device && expected(message))
    }

    pub fn next_binary(&mut self) -> Vec<u8> {
        loop {
            if let Message::Binary(bytes) = self.next().expect("the page is open") {
                return bytes.to_vec();
            }
        }
    }

    /// Sends a request with an id, and waits for its answer.
    pub fn ask(&mut self, mut request: Value) -> Value {
        self.requests += 1;
        let id = self.requests;
        request["id"] = json!(id);
        self.send(&request);
        self.text(|message| message["type"] == "answer" && message["id"] == id)
    }

    /// Takes a device, sends the settings that it has, and starts it.
    pub fn ventilate(&mut self, device: u8) {
        self.send(&json!({"type": "take", "device": device}));
        self.text(|message| message["type"] == "steerer" && message["yours"] == true);
        self.state(device, |state| state["settings"].is_object());
        let applied = self.ask(json!({"type": "apply", "device": device, "settings": {}}));
        assert_eq!(applied["ok"], true, "{applied}");
        let deadline = std::time::Instant::now() + LONG;
        loop {
            let started = self.ask(json!({"type": "start", "device": device}));
            if started["ok"] == true {
                return;
            }
            // A start does not wait for the self-test.
            assert!(started["text"].as_str().unwrap().contains("self-test"), "{started}");
            assert!(std::time::Instant::now() < deadline, "the self-test does not end");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Waits until the server closes the page; returns its code.
    pub fn closed(&mut self) -> Option<u16> {
        let deadline = std::time::Instant::now() + LONG;
        loop {
            assert!(std::time::Instant::now() < deadline, "the page is not closed");
            match self.next() {
                Some(Message::Close(frame)) => return frame.map(|frame| frame.code.into()),
                Some(_) => {}
                None => return None,
            }
        }
    }
}

/// A binary message, decoded.
pub struct Samples {
    pub device: u8,
    pub dropped: u32,
    pub tick: u64,
    /// When the last one came to the server, ms since 1970.
    pub time_ms: u64,
    pub columns: Vec<Vec<f32>>,
    pub phases: Vec<u8>,
}

/// Decodes a binary message.
pub fn samples(bytes: &[u8]) -> Samples {
    assert_eq!(bytes[0], 1);
    let count = usize::from(u16::from_le_bytes(bytes[2..4].try_into().unwrap()));
    let number = |place: usize| f32::from_le_bytes(bytes[24 + 4 * place..][..4].try_into().unwrap());
    Samples {
        device: bytes[1],
        dropped: u32::from_le_bytes(bytes[4..8].try_into().unwrap()),
        tick: f64::from_le_bytes(bytes[8..16].try_into().unwrap()) as u64,
        time_ms: f64::from_le_bytes(bytes[16..24].try_into().unwrap()) as u64,
        columns: (0..7).map(|column| (0..count).map(|row| number(column * count + row)).collect()).collect(),
        phases: bytes[24 + 28 * count..][..count].to_vec(),
    }
}

/// Requests a path with more headers, or another Host; returns status, headers and body.
pub fn get(server: &Server, path: &str, headers: &[(&str, &str)]) -> (u16, String, String) {
    let mut stream = TcpStream::connect(server.address()).unwrap();
    stream.set_read_timeout(Some(LONG)).unwrap();
    let own = server.address().to_string();
    let host = headers.iter().find(|(name, _)| *name == "host").map_or(own.as_str(), |(_, value)| value);
    let mut text = format!("GET {path} HTTP/1.1\r\nhost: {host}\r\nconnection: close\r\n");
    for (name, value) in headers.iter().filter(|(name, _)| *name != "host") {
        let _ = write!(text, "{name}: {value}\r\n");
    }
    stream.write_all((text + "\r\n").as_bytes()).unwrap();
    let mut response = String::new();
    stream.read_to_string(&mut response).unwrap();
    let (head, body) = response.split_once("\r\n\r\n").unwrap();
    let status = head.split(' ').nth(1).unwrap().parse().unwrap();
    (status, head.to_lowercase(), body.to_owned())
}

/// A simulated device with an airway sensor alone that runs as fast as it can; it ends with the list.
pub fn fast(served: &mut Vec<Served>) -> Watch {
    fast_on(&BenchConfig::paper(20.0, 20.0), false, served)
}

/// The same on another bench, with all of its sensors if `all_sensors`.
pub fn fast_on(bench: &BenchConfig, all_sensors: bool, served: &mut Vec<Served>) -> Watch {
    let config = ServedConfig { pace: MOST_PACE, weights: None, all_sensors, keeps_truth: false };
    let device = Served::with(bench, config).unwrap();
    let (watch, identity) = Watch::port(device.address());
    identity.unwrap();
    served.push(device);
    watch
}

/// A device at a cable that a test cuts.
pub struct Cable {
    listener: TcpListener,
    plugged: Option<(Simulated, TcpStream)>,
}

impl Cable {
    /// A device that is plugged in, and watched.
    pub fn with_watch() -> (Self, Watch) {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = Address::Tcp(listener.local_addr().unwrap().to_string());
        let accepting = std::thread::spawn(move || Self { listener, plugged: None }.plug_in());
        let (watch, identity) = Watch::port(&address);
        identity.unwrap();
        (accepting.join().unwrap(), watch)
    }

    /// A device that is plugged in at this address, where a server tries to connect.
    pub fn at(address: &Address) -> Self {
        Self {
            listener: TcpListener::bind(address.to_string().trim_start_matches("tcp:")).unwrap(),
            plugged: None,
        }
        .plug_in()
    }

    /// Plugs a new device in.
    pub fn plug_in(self) -> Self {
        let (stream, _) = self.listener.accept().unwrap();
        stream.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
        let cable = stream.try_clone().unwrap();
        let reader: Box<dyn Read + Send> = Box::new(stream.try_clone().unwrap());
        let device =
            Simulated::start(&BenchConfig::paper(20.0, 20.0), Port { reader, writer: Box::new(stream) });
        Self { plugged: Some((device.unwrap(), cable)), ..self }
    }

    /// Cuts it.
    pub fn cut(self) -> Self {
        if let Some((_, cable)) = &self.plugged {
            cable.shutdown(std::net::Shutdown::Both).unwrap();
        }
        Self { plugged: None, ..self }
    }
}
