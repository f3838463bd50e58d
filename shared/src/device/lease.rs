//! The lease: one host at a time may change the device; every other host only reads.
//!
//! A device has one line, so a host is a program, not a connection: each chooses a random token and sends it with its requests.
//! The token prevents accidents, such as two programs that change settings in turn; it does not authenticate.
//!
//! The lease lapses after [`LEASE_S`] without a request from its holder, so that a program that has ended or hangs blocks nobody.
//! A person at the bedside does not have to wait: a host that says so takes the lease over at once, and with it can stop
//! ventilation and acknowledge alarms. No program does that by itself.

use super::HostRole;
use crate::link::host_name::HostName;
use crate::link::messages::LeaseStatus;
use crate::link::refusal::Refusal;
use crate::math;
use crate::timing::LEASE_S;

/// The host that steers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Holder {
    token: u32,
    name: HostName,
    /// Control tick of its last request.
    heard: u32,
}

/// The lease of a device. Fulfils: lease.
#[derive(Clone, Debug)]
pub struct Lease {
    /// Ticks for which its holder may be silent.
    allowed: u32,
    holder: Option<Holder>,
    /// Token of the host that holds it or held it last, and whether that one has given it back.
    last: Option<u32>,
    given_back: bool,
}

impl Lease {
    /// A lease that nobody holds, for a control period in microseconds.
    pub fn new(period_us: u32) -> Self {
        Self { allowed: math::ticks(LEASE_S, period_us), holder: None, last: None, given_back: false }
    }

    /// Takes note of a request at a control tick, before anything else: it renews the lease of its holder, and ends one whose
    /// holder was silent for too long.
    pub fn heard(&mut self, host: Option<u32>, tick: u32) {
        self.holder = self.holder.filter(|holder| tick.wrapping_sub(holder.heard) <= self.allowed);
        if let Some(holder) = &mut self.holder
            && Some(holder.token) == host
        {
            holder.heard = tick;
        }
    }

    /// What a host is to the running ventilation. One whose lease has lapsed still steers until another one acquires it.
    pub fn role(&self, host: Option<u32>) -> HostRole {
        match self.last {
            Some(token) if Some(token) == host => HostRole::Steers,
            Some(_) if !self.given_back => HostRole::Reads,
            _ => HostRole::Attends,
        }
    }

    /// Who steers, as this host sees it.
    pub fn status(&self, host: Option<u32>) -> LeaseStatus {
        let holder = self.holder.map(|holder| holder.name);
        LeaseStatus { holder, yours: self.permits(host).is_ok() }
    }

    /// Whether a host may change the device.
    ///
    /// # Errors
    /// [`Refusal::Lease`] with the holder's name, or [`Refusal::NoLease`] if nobody holds it.
    pub fn permits(&self, host: Option<u32>) -> Result<(), Refusal> {
        match &self.holder {
            Some(holder) if Some(holder.token) == host => Ok(()),
            Some(holder) => Err(Refusal::Lease { holder: holder.name }),
            None => Err(Refusal::NoLease),
        }
    }

    /// Gives the lease to a host, at a control tick; `take_over` takes it from another one.
    ///
    /// # Errors
    /// [`Refusal::Lease`] if another host holds it, [`Refusal::NoLease`] if the host sends no token.
    pub fn acquire(
        &mut self,
        host: Option<u32>,
        name: HostName,
        take_over: bool,
        tick: u32,
    ) -> Result<LeaseStatus, Refusal> {
        let token = host.ok_or(Refusal::NoLease)?;
        match self.permits(host) {
            Err(held @ Refusal::Lease { .. }) if !take_over => return Err(held),
            _ => self.holder = Some(Holder { token, name, heard: tick }),
        }
        (self.last, self.given_back) = (host, false);
        debug_assert!(self.permits(host).is_ok());
        Ok(self.status(host))
    }

    /// Gives the lease back, if this host holds it; one whose lease has lapsed says that it leaves.
    pub fn release(&mut self, host: Option<u32>) -> LeaseStatus {
        if self.permits(host).is_ok() {
            self.holder = None;
        }
        self.given_back |= self.holder.is_none() && self.role(host) == HostRole::Steers;
        debug_assert!(self.permits(host).is_err());
        self.status(host)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ANNA: Option<u32> = Some(1);
    const BERT: Option<u32> = Some(2);
    const LEASE_TICKS: u32 = 5000;

    fn name(text: &str) -> HostName {
        HostName::new(text)
    }

    /// A lease that Anna has held since this tick.
    fn held(tick: u32) -> Lease {
        let mut lease = Lease::new(1000);
        let status = LeaseStatus { holder: Some(name("anna")), yours: true };
        assert_eq!(lease.acquire(ANNA, name("anna"), false, tick), Ok(status));
        lease
    }

    fn held_by_anna() -> Refusal {
        Refusal::Lease { holder: name("anna") }
    }

    #[test]
    fn only_the_host_that_has_acquired_it_may_change_something() {
        let mut lease = Lease::new(1000);
        assert_eq!(lease.permits(ANNA), Err(Refusal::NoLease), "nobody by default");
        assert_eq!(lease.acquire(None, name("nobody"), true, 0), Err(Refusal::NoLease), "without a token");
        lease = held(0);
        assert_eq!(lease.permits(ANNA), Ok(()));
        assert_eq!((lease.permits(BERT), lease.permits(None)), (Err(held_by_anna()), Err(held_by_anna())));
        assert_eq!(lease.acquire(BERT, name("bert"), false, 1), Err(held_by_anna()));
        assert_eq!(lease.status(BERT), LeaseStatus { holder: Some(name("anna")), yours: false });
    }

    #[test]
    fn it_lapses_after_five_seconds_of_silence_and_each_request_of_its_holder_renews_it() {
        for start in [0, u32::MAX - 7000] {
            let mut lease = held(start);
            for tick in [LEASE_TICKS, 2 * LEASE_TICKS] {
                lease.heard(ANNA, start.wrapping_add(tick));
                assert_eq!(lease.permits(ANNA), Ok(()), "renewed at {tick}");
            }
            lease.heard(BERT, start.wrapping_add(3 * LEASE_TICKS));
            assert_eq!(lease.permits(BERT), Err(held_by_anna()), "another host does not renew it");
            lease.heard(BERT, start.wrapping_add(3 * LEASE_TICKS + 1));
            assert_eq!(lease.permits(BERT), Err(Refusal::NoLease));
            assert_eq!(lease.permits(ANNA), Err(Refusal::NoLease), "it does not come back by itself");
        }
    }

    #[test]
    fn it_can_be_released_by_its_holder_alone() {
        let mut lease = held(0);
        assert_eq!(lease.release(BERT), LeaseStatus { holder: Some(name("anna")), yours: false });
        assert_eq!(lease.release(ANNA), LeaseStatus { holder: None, yours: false });
        assert!(lease.acquire(BERT, name("bert"), false, 1).is_ok_and(|status| status.yours));
    }

    #[test]
    fn a_lease_that_has_lapsed_is_given_back_by_its_last_holder_alone() {
        let mut lease = held(0);
        lease.heard(None, LEASE_TICKS + 1);
        lease.release(BERT);
        assert_eq!((lease.role(ANNA), lease.role(BERT)), (HostRole::Steers, HostRole::Reads));
        lease.release(ANNA);
        assert_eq!((lease.role(ANNA), lease.role(BERT)), (HostRole::Steers, HostRole::Attends));
    }

    #[test]
    fn a_person_at_the_bedside_takes_it_over_at_once() {
        let mut lease = held(0);
        assert!(lease.acquire(BERT, name("bert"), true, 1).is_ok_and(|status| status.yours));
        assert_eq!(lease.permits(ANNA), Err(Refusal::Lease { holder: name("bert") }));
    }
}
