//! Steering from pages: one page at a time, and requests that the core's bounds allow.

use std::collections::BTreeMap;

use monitoring::words;
use shared::device::annunciator::AUDIO_PAUSE_MAX;
use shared::link::messages::{Request, Response};
use shared::settings::{FIELDS, Settings, SettingsError};
use thiserror::Error;

use crate::stream::{Answer, FromPage};

/// Why a page's request is not sent to the device.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum SteerError {
    /// The server was started to show, not to steer.
    #[error(
        "read only: start `trainer serve` with --steer, and open the address with the token that it prints"
    )]
    ReadOnly,
    /// Another page steers.
    #[error("{0} steers this device")]
    Other(String),
    /// No page steers.
    #[error("take control of the device first")]
    NotTaken,
    /// The settings in force are not known yet.
    #[error("the device's settings are not known yet")]
    Unknown,
    /// A setting that does not exist.
    #[error("there is no setting '{0}'")]
    NoSuchSetting(String),
    /// Settings that the core refuses.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// A pause that is too long.
    #[error("an audio pause lasts at most {AUDIO_PAUSE_MAX} s")]
    Pause,
}

/// The page that steers a device, if any.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Wheel {
    holder: Option<(u64, String)>,
}

impl Wheel {
    /// Gives it to a page, by number and name; takes it from another page only if `take_over`.
    ///
    /// # Errors
    /// [`SteerError::Other`].
    pub fn take(&mut self, viewer: u64, who: &str, take_over: bool) -> Result<(), SteerError> {
        match &self.holder {
            Some((holder, who)) if *holder != viewer && !take_over => Err(SteerError::Other(who.clone())),
            _ => {
                self.holder = Some((viewer, who.to_owned()));
                Ok(())
            }
        }
    }

    /// Takes it back from a page; whether that page had it.
    pub fn release(&mut self, viewer: u64) -> bool {
        self.holder.take_if(|(holder, _)| *holder == viewer).is_some()
    }

    /// Takes it back from whichever page has it; whether one had it.
    pub fn free(&mut self) -> bool {
        self.holder.take().is_some()
    }

    /// Whether a page has it.
    ///
    /// # Errors
    /// [`SteerError::Other`] or [`SteerError::NotTaken`].
    pub fn check(&self, viewer: u64) -> Result<(), SteerError> {
        match &self.holder {
            Some((holder, _)) if *holder == viewer => Ok(()),
            Some((_, who)) => Err(SteerError::Other(who.clone())),
            None => Err(SteerError::NotTaken),
        }
    }

    /// The page that has it: number and name.
    pub fn holder(&self) -> Option<&(u64, String)> {
        self.holder.as_ref()
    }

    /// Who has it, in words.
    pub fn who(&self) -> Option<&str> {
        self.holder.as_ref().map(|(_, who)| who.as_str())
    }

    /// Whether this page has it.
    pub fn is_with(&self, viewer: u64) -> bool {
        self.check(viewer).is_ok()
    }
}

/// The request to the device for a message of a page, if there is one. `current` are the settings that apply next.
///
/// # Errors
/// [`SteerError`], if the core would refuse it.
pub fn request(message: &FromPage, current: Option<&Settings>) -> Result<Option<Request>, SteerError> {
    Ok(Some(match message {
        FromPage::Apply { settings, .. } => {
            Request::ApplySettings(changed(current.ok_or(SteerError::Unknown)?, settings)?)
        }
        FromPage::Start { .. } => Request::Start,
        FromPage::Stop { .. } => Request::Stop,
        FromPage::Acknowledge { .. } => Request::Acknowledge,
        FromPage::PauseAudio { seconds, .. } if *seconds <= AUDIO_PAUSE_MAX => {
            Request::PauseAudio { seconds: *seconds }
        }
        FromPage::PauseAudio { .. } => return Err(SteerError::Pause),
        _ => return Ok(None),
    }))
}

/// Settings with changes, which must be valid.
fn changed(current: &Settings, changes: &BTreeMap<String, f32>) -> Result<Settings, SteerError> {
    let mut values = current.values();
    for (name, value) in changes {
        let place = FIELDS.iter().position(|field| field.name == name);
        values[place.ok_or_else(|| SteerError::NoSuchSetting(name.clone()))?] = *value;
    }
    let settings = Settings::from_values(values);
    settings.validate()?;
    Ok(settings)
}

/// The answer to a page, from that of the device.
pub fn answer(id: u32, result: &Result<Response, String>) -> Answer {
    match result {
        Err(why) => Answer::refused(Some(id), why),
        Ok(Response::Settings { in_force, pending: None }) => {
            Answer { settings: Some(*in_force), ..Answer::done(id, "in force now") }
        }
        Ok(Response::Settings { pending: Some(pending), .. }) => {
            Answer { settings: Some(*pending), ..Answer::done(id, "from the next breath on") }
        }
        Ok(Response::Mode(mode)) => Answer::done(id, words::mode(*mode)),
        Ok(Response::Audio(audio)) => Answer::done(id, words::audio(audio)),
        Ok(_) => Answer::done(id, "done"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn apply(changes: &[(&str, f32)]) -> FromPage {
        let settings = changes.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect();
        FromPage::Apply { id: 1, device: 0, settings }
    }

    #[test]
    fn one_page_steers_and_others_see_which() {
        let mut wheel = Wheel::default();
        assert_eq!(wheel.check(1), Err(SteerError::NotTaken));
        assert_eq!((wheel.take(1, "page 1", false), wheel.take(1, "page 1", false)), (Ok(()), Ok(())));
        let other = SteerError::Other("page 1".into());
        assert_eq!((wheel.take(2, "page 2", false), wheel.check(2)), (Err(other.clone()), Err(other)));
        assert_eq!((wheel.check(1), wheel.who()), (Ok(()), Some("page 1")));
        assert!(!wheel.release(2) && wheel.release(1));
        assert_eq!(wheel.who(), None);
        assert_eq!(wheel.take(2, "page 2", false), Ok(()));
        assert_eq!(wheel.take(1, "page 1", true), Ok(()), "taken over");
        assert_eq!((wheel.who(), wheel.is_with(2)), (Some("page 1"), false));
        assert!(wheel.free() && !wheel.free());
    }

    #[test]
    fn a_change_keeps_all_other_settings() {
        let current = Settings { rate: 15.0, peep: 7.0, ..Settings::default() };
        let request = request(&apply(&[("pip", 25.0)]), Some(&current)).unwrap();
        assert_eq!(request, Some(Request::ApplySettings(Settings { pip: 25.0, ..current })));
    }

    #[test]
    fn a_change_beyond_the_cores_bounds_is_not_sent() {
        let current = Settings::default();
        let refused =
            |changes: &[(&str, f32)]| request(&apply(changes), Some(&current)).unwrap_err().to_string();
        assert!(refused(&[("pip", 90.0)]).starts_with("pip is 90 cmH2O, allowed are 5 to 60"));
        assert!(refused(&[("pip", f32::NAN)]).starts_with("pip is NaN"));
        assert!(refused(&[("pip", 6.0)]).contains("above PEEP"), "relations count too");
        assert_eq!(refused(&[("volume", 1.0)]), "there is no setting 'volume'");
        assert_eq!(request(&apply(&[]), None), Err(SteerError::Unknown));
    }

    #[test]
    fn a_pause_lasts_at_most_two_minutes() {
        let pause = |seconds| request(&FromPage::PauseAudio { id: 1, device: 0, seconds }, None);
        assert_eq!(pause(120), Ok(Some(Request::PauseAudio { seconds: 120 })));
        assert_eq!(pause(121), Err(SteerError::Pause));
    }

    #[test]
    fn an_answer_holds_the_settings_that_apply() {
        let (in_force, next) = (Settings::default(), Settings { pip: 25.0, ..Settings::default() });
        let at_once = answer(4, &Ok(Response::Settings { in_force, pending: None }));
        assert_eq!((at_once.id, at_once.ok, at_once.settings), (Some(4), true, Some(in_force)));
        let later = answer(4, &Ok(Response::Settings { in_force, pending: Some(next) }));
        assert_eq!((later.text.as_str(), later.settings), ("from the next breath on", Some(next)));
        let refused = answer(4, &Err("another host steers".into()));
        assert!(!refused.ok && refused.text == "another host steers");
    }

    proptest! {
        #[test]
        fn whatever_is_sent_is_valid(changes in prop::collection::vec((0..FIELDS.len(), any::<f32>()), 0..4)) {
            let named: Vec<_> = changes.iter().map(|(place, value)| (FIELDS[*place].name, *value)).collect();
            if let Ok(Some(Request::ApplySettings(settings))) = request(&apply(&named), Some(&Settings::default())) {
                prop_assert_eq!(settings.validate(), Ok(()));
            }
        }
    }
}
