//! The shared library inside an FMU: the functions of FMI 2.0 for co-simulation, which a simulator calls. Each checks what it got and
//! passes it to a [`Component`]; all else is in the crate `fmu`.
//!
//! All pointers come from the simulator. The standard obliges it to pass texts that end with a zero, arrays of at least the length that
//! it gives with them, and an instance that `fmi2Instantiate` made and `fmi2FreeInstance` has not yet freed, in one call at a time.
//! That is what each `unsafe` block relies on. A null pointer is an error wherever it could be one.

use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::ptr;

use fmu::{Component, FmuError};

/// What a call answers.
type Status = c_int;
const OK: Status = 0;
const ERROR: Status = 3;
const FATAL: Status = 4;
/// The number of co-simulation among the kinds of FMU.
const CO_SIMULATION: c_int = 1;

/// Takes messages for the user: environment, name of the instance, status, category, a format and its values.
type Log = unsafe extern "C" fn(*mut c_void, *const c_char, Status, *const c_char, *const c_char, ...);

/// Functions of the simulator.
#[repr(C)]
struct Callbacks {
    log: Option<Log>,
    /// Not used: functions for memory, and the end of a step.
    others: [Option<unsafe extern "C" fn()>; 3],
    environment: *mut c_void,
}

/// Sends messages to the simulator.
struct Teller {
    log: Option<Log>,
    environment: *mut c_void,
    name: CString,
}

impl Teller {
    fn tell(&self, message: &str) {
        let Some(log) = self.log else { return };
        let text = CString::new(message.replace('\0', " ")).unwrap_or_default();
        // SAFETY: all texts end with a zero and outlive the call, and the format takes one text.
        unsafe {
            log(
                self.environment,
                self.name.as_ptr(),
                ERROR,
                c"logStatusError".as_ptr(),
                c"%s".as_ptr(),
                text.as_ptr(),
            );
        }
    }
}

/// An instance, of which the simulator has the address.
struct Instance {
    component: Component,
    teller: Teller,
}

/// Runs on an instance and tells the simulator why it fails. A panic must not unwind into C.
fn on(instance: *mut c_void, run: impl FnOnce(&mut Component) -> Result<(), FmuError>) -> Status {
    // SAFETY: see the top of this file.
    let Some(instance) = (unsafe { instance.cast::<Instance>().as_mut() }) else { return ERROR };
    match catch_unwind(AssertUnwindSafe(|| run(&mut instance.component))) {
        Ok(Ok(())) => OK,
        Ok(Err(reason)) => {
            instance.teller.tell(&reason.to_string());
            ERROR
        }
        Err(_) => FATAL,
    }
}

/// A text of the simulator; none for a null pointer.
fn text(pointer: *const c_char) -> Option<String> {
    // SAFETY: see the top of this file.
    (!pointer.is_null()).then(|| unsafe { CStr::from_ptr(pointer) }.to_string_lossy().into_owned())
}

/// An array of the simulator; empty for a null pointer.
fn array<'a, T>(pointer: *const T, length: usize) -> &'a [T] {
    // SAFETY: see the top of this file.
    if pointer.is_null() { &[] } else { unsafe { std::slice::from_raw_parts(pointer, length) } }
}

/// An array of the simulator to be filled; empty for a null pointer.
fn places<'a, T>(pointer: *mut T, length: usize) -> &'a mut [T] {
    // SAFETY: see the top of this file.
    if pointer.is_null() { &mut [] } else { unsafe { std::slice::from_raw_parts_mut(pointer, length) } }
}

#[unsafe(no_mangle)]
extern "C" fn fmi2GetTypesPlatform() -> *const c_char {
    c"default".as_ptr()
}

#[unsafe(no_mangle)]
extern "C" fn fmi2GetVersion() -> *const c_char {
    c"2.0".as_ptr()
}

#[unsafe(no_mangle)]
extern "C" fn fmi2Instantiate(
    name: *const c_char,
    kind: c_int,
    guid: *const c_char,
    resources: *const c_char,
    callbacks: *const Callbacks,
    _visible: c_int,
    _logging: c_int,
) -> *mut c_void {
    // SAFETY: see the top of this file.
    let (log, environment) = match unsafe { callbacks.as_ref() } {
        Some(callbacks) => (callbacks.log, callbacks.environment),
        None => (None, ptr::null_mut()),
    };
    let name = CString::new(text(name).unwrap_or_default()).unwrap_or_default();
    let teller = Teller { log, environment, name };
    if kind != CO_SIMULATION {
        teller.tell("this FMU is for co-simulation only");
        return ptr::null_mut();
    }
    let (address, guid) = (text(resources).unwrap_or_default(), text(guid).unwrap_or_default());
    match catch_unwind(|| Component::at(&address, &guid)) {
        Ok(Ok(component)) => Box::into_raw(Box::new(Instance { component, teller })).cast(),
        Ok(Err(reason)) => {
            teller.tell(&reason.to_string());
            ptr::null_mut()
        }
        Err(_) => ptr::null_mut(),
    }
}

#[unsafe(no_mangle)]
extern "C" fn fmi2FreeInstance(instance: *mut c_void) {
    if !instance.is_null() {
        // SAFETY: a box made it, and the simulator never uses it again.
        drop(unsafe { Box::from_raw(instance.cast::<Instance>()) });
    }
}

#[unsafe(no_mangle)]
extern "C" fn fmi2SetDebugLogging(
    instance: *mut c_void,
    _on: c_int,
    _length: usize,
    _categories: *const *const c_char,
) -> Status {
    on(instance, |_| Ok(()))
}

#[unsafe(no_mangle)]
extern "C" fn fmi2SetupExperiment(
    instance: *mut c_void,
    _has_tolerance: c_int,
    _tolerance: f64,
    start: f64,
    _has_end: c_int,
    _end: f64,
) -> Status {
    on(instance, |component| component.begin_at(start))
}

#[unsafe(no_mangle)]
extern "C" fn fmi2EnterInitializationMode(instance: *mut c_void) -> Status {
    on(instance, |_| Ok(()))
}

#[unsafe(no_mangle)]
extern "C" fn fmi2ExitInitializationMode(instance: *mut c_void) -> Status {
    on(instance, Component::start)
}

#[unsafe(no_mangle)]
extern "C" fn fmi2Terminate(instance: *mut c_void) -> Status {
    on(instance, |_| Ok(()))
}

#[unsafe(no_mangle)]
extern "C" fn fmi2Reset(instance: *mut c_void) -> Status {
    on(instance, |component| {
        component.reset();
        Ok(())
    })
}

#[unsafe(no_mangle)]
extern "C" fn fmi2GetReal(
    instance: *mut c_void,
    references: *const u32,
    length: usize,
    values: *mut f64,
) -> Status {
    on(instance, |component| {
        let mut pairs = array(references, length).iter().zip(places(values, length));
        pairs.try_for_each(|(reference, value)| {
            *value = component.real(*reference)?;
            Ok(())
        })
    })
}

#[unsafe(no_mangle)]
extern "C" fn fmi2SetReal(
    instance: *mut c_void,
    references: *const u32,
    length: usize,
    values: *const f64,
) -> Status {
    on(instance, |component| {
        let mut pairs = array(references, length).iter().zip(array(values, length));
        pairs.try_for_each(|(reference, value)| component.set_real(*reference, *value))
    })
}

#[unsafe(no_mangle)]
extern "C" fn fmi2GetInteger(
    instance: *mut c_void,
    references: *const u32,
    length: usize,
    values: *mut c_int,
) -> Status {
    on(instance, |component| {
        let mut pairs = array(references, length).iter().zip(places(values, length));
        pairs.try_for_each(|(reference, value)| {
            *value = component.integer(*reference)?;
            Ok(())
        })
    })
}

#[unsafe(no_mangle)]
extern "C" fn fmi2SetInteger(
    instance: *mut c_void,
    references: *const u32,
    length: usize,
    values: *const c_int,
) -> Status {
    on(instance, |component| {
        let mut pairs = array(references, length).iter().zip(array(values, length));
        pairs.try_for_each(|(reference, value)| component.set_integer(*reference, *value))
    })
}

#[unsafe(no_mangle)]
extern "C" fn fmi2DoStep(instance: *mut c_void, time: f64, step: f64, _keeps_state: c_int) -> Status {
    on(instance, |component| component.advance(time + step))
}

/// Functions with arguments that this FMU never looks at: its description offers neither the state nor derivatives, and has no variable
/// of these types. Each answers an error if it is asked for anything, which its second argument tells.
macro_rules! without {
    ($($name:ident)*) => {$(
        #[unsafe(no_mangle)]
        extern "C" fn $name(_instance: *mut c_void, _first: *const c_void, length: usize, _last: *mut c_void) -> Status {
            if length == 0 { OK } else { ERROR }
        }
    )*};
}

without! { fmi2GetBoolean fmi2SetBoolean fmi2GetString fmi2SetString }

/// Functions of abilities that the description does not offer; they look at none of their arguments.
macro_rules! unable {
    ($($name:ident)*) => {$(
        #[unsafe(no_mangle)]
        extern "C" fn $name() -> Status {
            ERROR
        }
    )*};
}

unable! {
    fmi2GetFMUstate fmi2SetFMUstate fmi2FreeFMUstate fmi2SerializedFMUstateSize fmi2SerializeFMUstate fmi2DeSerializeFMUstate
    fmi2GetDirectionalDerivative fmi2SetRealInputDerivatives fmi2GetRealOutputDerivatives fmi2CancelStep fmi2GetStatus
    fmi2GetRealStatus fmi2GetIntegerStatus fmi2GetBooleanStatus fmi2GetStringStatus
}
