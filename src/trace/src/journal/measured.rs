//! What was measured beside the records of an episode: clocks, what a robot says of itself, its camera and what
//! else its recording holds. No link of the hash chain covers any of it.

use std::{
    collections::BTreeMap,
    io::{Seek, Write},
};

use super::{Expected, Journal};
use crate::{
    AnsweredRequest, Images, Timing, TraceError, codec, mcp_answer,
    robot::{Alignment, CameraImage, Odometry, PrimitiveOutcome, RobotLog, VlaLatency},
    schema::{self, reel},
    sensors::{SensorChannel, SensorKind},
    viewer,
};

impl<W: Write + Seek> Journal<W> {
    /// Records when the call of the step that is under way was made, and how long it took.
    pub(crate) fn timing(&mut self, step: u32, timing: &Timing) -> Result<(), TraceError> {
        if !matches!(&self.turn, Expected::Step { step: under_way, .. } if *under_way == step) {
            return Err(self.out_of_turn(&format!("the timing of step {step}")));
        }
        self.message(schema::TIMING, &codec::timing(step, timing))
    }

    /// Records what a server answered, as it came; without images, only what holds none.
    pub(crate) fn mcp_answer(
        &mut self,
        request: AnsweredRequest,
        json: &str,
    ) -> Result<(), TraceError> {
        self.expect_moment(request.step(), "the answer of a server")?;
        if self.images == Images::None && mcp_answer::has_image(json) {
            return Ok(());
        }
        self.message(schema::MCP_ANSWER, &mcp_answer::message(request, json))
    }

    /// Records how many secrets were replaced by labels, by rule.
    pub(crate) fn redacted(
        &mut self,
        step: Option<u32>,
        count: &BTreeMap<String, u64>,
    ) -> Result<(), TraceError> {
        self.expect_moment(step, "the count of redactions")?;
        let count = count.clone();
        self.message(schema::REDACTED, &reel::Redacted { step, count })
    }

    /// Records where the robot was.
    pub(crate) fn odometry(&mut self, measured: &Odometry) -> Result<(), TraceError> {
        self.expect_moment(measured.step, "odometry")?;
        self.message(schema::ODOMETRY, &codec::odometry(measured))
    }

    /// Records what a skill came to.
    pub(crate) fn primitive(&mut self, outcome: &PrimitiveOutcome) -> Result<(), TraceError> {
        self.expect_moment(outcome.step, "the outcome of a primitive")?;
        self.message(schema::PRIMITIVE, &reel::PrimitiveOutcome::from(outcome))
    }

    /// Records how long an inference of the low-level model took.
    pub(crate) fn vla(&mut self, measured: &VlaLatency) -> Result<(), TraceError> {
        self.expect_moment(measured.step, "a latency")?;
        self.message(schema::VLA, &reel::VlaLatency::from(measured))
    }

    /// Records how far the robot was off.
    pub(crate) fn alignment(&mut self, measured: &Alignment) -> Result<(), TraceError> {
        self.expect_moment(measured.step, "an alignment")?;
        self.message(schema::ALIGNMENT, &reel::Alignment::from(measured))
    }

    /// Records everything that a log holds of a moment.
    pub(crate) fn robot(&mut self, step: Option<u32>, log: &RobotLog) -> Result<(), TraceError> {
        log.odometry
            .iter()
            .filter(|it| it.step == step)
            .try_for_each(|it| self.odometry(it))?;
        log.primitives
            .iter()
            .filter(|it| it.step == step)
            .try_for_each(|it| self.primitive(it))?;
        log.vla
            .iter()
            .filter(|it| it.step == step)
            .try_for_each(|it| self.vla(it))?;
        log.alignments
            .iter()
            .filter(|it| it.step == step)
            .try_for_each(|it| self.alignment(it))
    }

    /// Records the camera's image as it came.
    pub(crate) fn original(
        &mut self,
        step: Option<u32>,
        image: &CameraImage,
    ) -> Result<(), TraceError> {
        self.expect_moment(step, "the image of the camera")?;
        if self.images == Images::None {
            return Ok(());
        }
        self.message(
            schema::CAMERA_ORIGINAL,
            &viewer::image_message(self.time_ns(), &image.format, image.data.clone()),
        )
    }

    /// Records what else the robot's recording holds, after the last step and before the end. A trace
    /// without images gets no cameras.
    pub(crate) fn sensors(&mut self, channels: &[SensorChannel]) -> Result<(), TraceError> {
        if !matches!(self.turn, Expected::InputOrEnd { .. }) {
            return Err(self.out_of_turn("the robot's recording"));
        }
        let without_images = self.images == Images::None;
        let kept = channels
            .iter()
            .filter(|channel| !(without_images && channel.kind == SensorKind::Camera));
        for (index, channel) in kept.enumerate() {
            self.with_writer(|writer| channel.write(index, writer))?;
        }
        Ok(())
    }

    /// What a robot measured belongs to the step under way, or stands before the start.
    fn expect_moment(&self, step: Option<u32>, what: &str) -> Result<(), TraceError> {
        match (&self.turn, step) {
            (Expected::Start, None) => Ok(()),
            (
                Expected::Step {
                    step: under_way, ..
                },
                Some(step),
            ) if *under_way == step => Ok(()),
            (_, None) => Err(self.out_of_turn(&format!("{what} of before the first step"))),
            (_, Some(step)) => Err(self.out_of_turn(&format!("{what} of step {step}"))),
        }
    }
}
