//! Which answers belong to a request, and which no device can give.

use std::fmt::Debug;

use shared::link::messages::{Request, Response};

use super::error::{DeviceError, LONGEST_US, SHORTEST_US};

/// Name of a message's variant.
pub(super) fn kind(message: &impl Debug) -> String {
    format!("{message:?}").chars().take_while(char::is_ascii_alphanumeric).collect()
}

/// The error of an answer that does not belong to its request.
pub(super) fn unexpected(request: &Request, response: &Response) -> DeviceError {
    DeviceError::Unexpected { request: kind(request), response: kind(response) }
}

/// Checks an answer before anything acts on it.
///
/// # Errors
/// [`DeviceError::Unexpected`], [`DeviceError::Period`] or [`DeviceError::Settings`].
pub(super) fn check(request: &Request, response: &Response) -> Result<(), DeviceError> {
    if !belongs(request, response) {
        return Err(unexpected(request, response));
    }
    match response {
        Response::Identity(identity) if !(SHORTEST_US..=LONGEST_US).contains(&identity.period_us) => {
            Err(DeviceError::Period(identity.period_us))
        }
        Response::Settings { in_force, pending } => in_force
            .validate()
            .and(pending.map_or(Ok(()), |next| next.validate()))
            .map_err(DeviceError::Settings),
        _ => Ok(()),
    }
}

/// Whether a response is the one that answers this request; a refusal answers all.
fn belongs(request: &Request, response: &Response) -> bool {
    match request {
        Request::Identify => matches!(response, Response::Identity(_)),
        Request::GetSettings | Request::ApplySettings(_) => matches!(response, Response::Settings { .. }),
        Request::Start | Request::Stop | Request::Acknowledge => matches!(response, Response::Mode(_)),
        Request::SetController(_) => matches!(response, Response::Controller(_)),
        Request::SetExploration(_) => matches!(response, Response::Exploration(_)),
        Request::SetSweep(_) => matches!(response, Response::Sweep(_)),
        Request::Telemetry { .. } => matches!(response, Response::Telemetry { .. }),
        Request::BeginWeights { .. } | Request::WeightsChunk { .. } => {
            matches!(response, Response::Progress { .. })
        }
        Request::CommitWeights => matches!(response, Response::Weights { .. }),
        Request::Reset | Request::ResetPlant { .. } | Request::ClearRecorder | Request::CommitBench => {
            matches!(response, Response::Done)
        }
        Request::QueueSettings(_) => matches!(response, Response::Queued { .. }),
        Request::GetTiming { .. } => matches!(response, Response::Timing(_)),
        Request::GetRecorder => matches!(response, Response::Recorder(_)),
        Request::ReadRecorder { .. } => matches!(response, Response::Recorded(_)),
        Request::GetAlarms => matches!(response, Response::Alarms(_)),
        Request::PauseAudio { .. } | Request::GetAudio => matches!(response, Response::Audio(_)),
        Request::GetSelfTest | Request::RunSelfTest(_) => matches!(response, Response::SelfTest(_)),
        Request::AcquireLease { .. } | Request::ReleaseLease | Request::GetLease => {
            matches!(response, Response::Lease(_))
        }
        Request::StoreCalibration(_) | Request::GetCalibration { .. } => {
            matches!(response, Response::Calibration { .. })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared::control::pid::PidGains;
    use shared::link::messages::{ControllerChoice, DeviceIdentity, DeviceKind};
    use shared::reset::ResetCause;
    use shared::settings::Settings;
    use shared::ventilator::Mode;
    use shared::weights::slots::SlotState;

    fn greeting(period_us: u32) -> Response {
        Response::Identity(DeviceIdentity {
            protocol: shared::link::PROTOCOL,
            firmware: [0, 1, 0],
            device: DeviceKind::ThirdParty,
            period_us,
            mode: Mode::Standby,
            controller: ControllerChoice::Pid(PidGains { p: 3.0, i: 30.0, d: 0.0 }),
            exploration: None,
            slots: [SlotState::Empty; 2],
            running: None,
            reset: ResetCause::PowerOn,
            failure: None,
            weights_key: None,
        })
    }

    #[test]
    fn a_greeting_needs_a_possible_period() {
        let accepted = |period_us| check(&Request::Identify, &greeting(period_us)).is_ok();
        assert!([250, 1000, 50_000].into_iter().all(accepted));
        assert!(![0, 1, 249, 50_001, 10_000_000, u32::MAX].into_iter().any(accepted));
    }

    #[test]
    fn settings_that_no_device_accepts_are_not_shown() {
        let reported = |in_force, pending| {
            check(&Request::GetSettings, &Response::Settings { in_force, pending })
                .map_err(|error| error.to_string())
        };
        let sound = Settings::default();
        assert_eq!(reported(sound, Some(sound)), Ok(()));
        let wrong = Settings { rate: f32::NAN, ..sound };
        assert!(reported(wrong, None).unwrap_err().contains("rate is NaN"));
        assert!(
            reported(sound, Some(Settings { peep: 900.0, ..sound })).unwrap_err().contains("peep is 900")
        );
    }

    #[test]
    fn an_answer_of_another_kind_is_named_beside_its_request() {
        let error = check(&Request::GetSettings, &Response::Mode(Mode::Standby)).unwrap_err().to_string();
        assert!(error.contains("answers GetSettings with Mode"), "{error}");
        let error = check(&Request::Telemetry { on: true }, &Response::Done).unwrap_err().to_string();
        assert!(error.contains("answers Telemetry with Done"), "{error}");
    }
}
