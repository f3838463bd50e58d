//! Watches four simulated devices of a real `trainer serve` at 1 kHz and counts every sample: shown, or lost on the way. Prints a line
//! a minute with the memory of the server, which Linux tells.
//!
//!     cargo build --release -p host --bin trainer
//!     cargo run --release -p bedside --example soak -- target/release/trainer 30

use std::error::Error;
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use futures_util::{SinkExt, StreamExt};
use serde_json::{Value, json};
use tokio::net::TcpStream;
use tokio::runtime::Builder;
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::{WebSocketStream, client_async};

/// The lungs of the devices.
const LUNGS: [&str; 4] = ["R5C50", "R20C20", "R20C50", "R50C10"];
/// Time without a message after which the soak fails.
const SILENCE: Duration = Duration::from_secs(10);

/// Longest time of a device's self-test.
const SELF_TEST: Duration = Duration::from_secs(30);

/// A server that ends with this.
struct Served(Child);

impl Drop for Served {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Served {
    /// Starts `trainer serve`; returns it with the address that it prints.
    fn start(trainer: &str) -> Result<(Self, String), Box<dyn Error>> {
        let mut command = Command::new(trainer);
        command.args(["serve", "--steer", "--listen", "127.0.0.1:0"]);
        for lung in LUNGS {
            command.args(["--bench", lung]);
        }
        let mut child = command.stdout(Stdio::piped()).spawn()?;
        let stdout = child.stdout.take().ok_or("the server has no output")?;
        let served = Self(child);
        let mut url = String::new();
        BufReader::new(stdout).read_line(&mut url)?;
        Ok((served, url.trim().to_owned()))
    }

    /// Resident memory, MB.
    fn memory(&self) -> Option<f64> {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.0.id())).ok()?;
        let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
        Some(line.trim().strip_suffix(" kB")?.parse::<f64>().ok()? / 1000.0)
    }

    /// Processor time so far, s.
    fn busy(&self) -> Option<f64> {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.0.id())).ok()?;
        let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
        // User and system time, in hundredths of a second.
        Some((fields.get(11)?.parse::<f64>().ok()? + fields.get(12)?.parse::<f64>().ok()?) / 100.0)
    }
}

/// Samples of one device.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    first: Option<u64>,
    next: u64,
    shown: u64,
    gaps: u64,
    dropped: u32,
    line: u64,
}

impl Tally {
    fn take(&mut self, bytes: &[u8]) -> Option<()> {
        let count = u64::from(u16::from_le_bytes(bytes.get(2..4)?.try_into().ok()?));
        self.dropped = u32::from_le_bytes(bytes.get(4..8)?.try_into().ok()?);
        let tick = f64::from_le_bytes(bytes.get(8..16)?.try_into().ok()?) as u64;
        if self.first.is_none() {
            (self.first, self.next) = (Some(tick), tick);
        }
        self.gaps += tick.saturating_sub(self.next);
        self.next = tick + count;
        self.shown += count;
        Some(())
    }
}

struct Page {
    socket: WebSocketStream<TcpStream>,
    tallies: [Tally; LUNGS.len()],
    requests: u32,
}

impl Page {
    async fn open(url: &str) -> Result<Self, Box<dyn Error>> {
        let (address, token) = url.split_once("/#token=").ok_or("the server prints no token")?;
        let host = address.strip_prefix("http://").ok_or("the server prints no address")?;
        let stream = TcpStream::connect(host).await?;
        let (socket, _) = client_async(format!("ws://{host}/api/stream"), stream).await?;
        let mut page = Self { socket, tallies: [Tally::default(); LUNGS.len()], requests: 0 };
        page.send(&json!({"type": "token", "token": token})).await?;
        Ok(page)
    }

    async fn send(&mut self, message: &Value) -> Result<(), Box<dyn Error>> {
        Ok(self.socket.send(Message::text(message.to_string())).await?)
    }

    /// The next text; samples are counted.
    async fn next(&mut self) -> Result<Option<Value>, Box<dyn Error>> {
        let message = tokio::time::timeout(SILENCE, self.socket.next()).await?;
        match message.ok_or("the server has closed the page")?? {
            Message::Binary(bytes) => {
                let device = usize::from(*bytes.get(1).ok_or("an empty message")?);
                let tally = self.tallies.get_mut(device).ok_or("an unknown device")?;
                tally.take(&bytes).ok_or("a message that is too short")?;
                Ok(None)
            }
            Message::Text(text) => {
                let message: Value = serde_json::from_str(&text)?;
                if message["type"] == "state" {
                    let device = message["device"].as_u64().unwrap_or_default() as usize;
                    let lost = message["line"]["lost_batches"].as_u64().unwrap_or_default();
                    self.tallies.get_mut(device).ok_or("an unknown device")?.line = lost;
                }
                Ok(Some(message))
            }
            _ => Ok(None),
        }
    }

    async fn wait(&mut self, wished: impl Fn(&Value) -> bool) -> Result<Value, Box<dyn Error>> {
        loop {
            if let Some(message) = self.next().await?
                && wished(&message)
            {
                return Ok(message);
            }
        }
    }

    async fn ventilate(&mut self, device: usize) -> Result<(), Box<dyn Error>> {
        self.send(&json!({"type": "take", "device": device})).await?;
        self.wait(|message| {
            message["type"] == "state" && message["device"] == device && message["settings"].is_object()
        })
        .await?;
        self.ask(json!({"type": "apply", "device": device, "settings": {}})).await?;
        let deadline = Instant::now() + SELF_TEST;
        while let Err(refused) = self.ask(json!({"type": "start", "device": device})).await {
            if Instant::now() > deadline {
                return Err(refused);
            }
            // The self-test of its start takes some seconds.
            let retry = Instant::now() + Duration::from_millis(500);
            while Instant::now() < retry {
                self.next().await?;
            }
        }
        Ok(())
    }

    /// Sends a request, and waits for its answer; an error if it is refused.
    async fn ask(&mut self, mut request: Value) -> Result<(), Box<dyn Error>> {
        self.requests += 1;
        let id = self.requests;
        request["id"] = json!(id);
        self.send(&request).await?;
        let answer = self.wait(|message| message["type"] == "answer" && message["id"] == id).await?;
        if answer["ok"] == true { Ok(()) } else { Err(answer["text"].to_string().into()) }
    }

    fn sum(&self, of: impl Fn(&Tally) -> u64) -> u64 {
        self.tallies.iter().map(of).sum()
    }
}

async fn soak(served: &Served, url: &str, minutes: u32) -> Result<(), Box<dyn Error>> {
    let mut page = Page::open(url).await?;
    for device in 0..LUNGS.len() {
        page.ventilate(device).await?;
    }
    let (started, before) = (Instant::now(), served.busy().unwrap_or_default());
    println!("minutes   samples   gaps   dropped   lost batches   server MB   core %");
    for minute in 0..=minutes {
        let until = started + Duration::from_mins(minute.into());
        while Instant::now() < until {
            page.next().await?;
        }
        let share = 100.0 * (served.busy().unwrap_or_default() - before) / started.elapsed().as_secs_f64();
        println!(
            "{minute:7} {:9} {:6} {:9} {:14} {:11.1} {share:8.1}",
            page.sum(|tally| tally.shown),
            page.sum(|tally| tally.gaps),
            page.sum(|tally| tally.dropped.into()),
            page.sum(|tally| tally.line),
            served.memory().unwrap_or(f64::NAN),
        );
    }
    let missing = page.sum(|tally| tally.next - tally.first.unwrap_or_default() - tally.shown);
    println!("{} samples shown, {missing} missing", page.sum(|tally| tally.shown));
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args().skip(1);
    let trainer = args.next().ok_or("name the trainer binary and the minutes")?;
    let minutes = args.next().map_or(Ok(30), |minutes| minutes.parse())?;
    let (served, url) = Served::start(&trainer)?;
    println!("process {}, to be watched in a browser, too: {url}", served.0.id());
    Builder::new_current_thread().enable_all().build()?.block_on(soak(&served, &url, minutes))
}
