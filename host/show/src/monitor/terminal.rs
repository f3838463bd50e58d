//! The monitor on a terminal: redraws a view several times a second and turns keys into requests.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

use super::News;
use super::draw::draw;
use super::session::Session;
use super::view::{Key, View};

/// Interval between redraws.
const PICTURE_EVERY: Duration = Duration::from_millis(50);

/// A key press.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pressed {
    /// A key that requests something from the device.
    Key(Key),
    /// Quit the monitor.
    Leave,
    /// Ctrl-C, which a terminal in raw mode reports as a key.
    Interrupt,
}

/// Meaning of a key; `None` if it has none.
pub fn meaning(event: &KeyEvent) -> Option<Pressed> {
    if event.kind == KeyEventKind::Release {
        return None;
    }
    if event.modifiers.contains(KeyModifiers::CONTROL) {
        return (event.code == KeyCode::Char('c')).then_some(Pressed::Interrupt);
    }
    let key = match event.code {
        KeyCode::Char(' ') => Key::StartStop,
        KeyCode::Char('a') => Key::Acknowledge,
        KeyCode::Char('m') => Key::PauseAudio,
        KeyCode::Char('p') => Key::Controller,
        KeyCode::Char('c') => Key::Confirm,
        KeyCode::Char('t') => Key::TakeOver,
        KeyCode::Up => Key::PipUp,
        KeyCode::Down => Key::PipDown,
        KeyCode::Right => Key::RateUp,
        KeyCode::Left => Key::RateDown,
        KeyCode::Char('q') | KeyCode::Esc => return Some(Pressed::Leave),
        _ => return None,
    };
    // A key held down must not start and stop a ventilator alternately.
    let repeats = matches!(key, Key::PipUp | Key::PipDown | Key::RateUp | Key::RateDown);
    (event.kind == KeyEventKind::Press || repeats).then_some(Pressed::Key(key))
}

/// Shows a device until the operator quits; Ctrl-C sets `stop` and also ends it. Passes on each piece of
/// news. Restores the terminal afterwards.
///
/// # Errors
/// The terminal cannot be drawn on.
pub fn run(
    session: &Session,
    view: &mut View,
    pass_on: &mut dyn FnMut(&News),
    stop: &AtomicBool,
) -> io::Result<()> {
    let mut terminal = ratatui::try_init()?;
    let result = show(&mut terminal, session, view, pass_on, stop);
    ratatui::try_restore()?;
    result
}

fn show(
    terminal: &mut DefaultTerminal,
    session: &Session,
    view: &mut View,
    pass_on: &mut dyn FnMut(&News),
    stop: &AtomicBool,
) -> io::Result<()> {
    while !stop.load(Ordering::Relaxed) {
        session.news().for_each(|news| {
            pass_on(&news);
            view.take(&news);
        });
        terminal.draw(|frame| draw(frame, view))?;
        let picture = Instant::now() + PICTURE_EVERY;
        while event::poll(picture.saturating_duration_since(Instant::now()))? {
            let Event::Key(key) = event::read()? else { continue };
            match meaning(&key) {
                Some(Pressed::Key(key)) => {
                    view.press(key).into_iter().for_each(|request| session.ask(request));
                }
                Some(Pressed::Leave) => return Ok(()),
                Some(Pressed::Interrupt) => stop.store(true, Ordering::Relaxed),
                None => {}
            }
        }
    }
    Ok(())
}
