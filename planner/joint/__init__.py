"""The position-and-time program: transcription, Newton steps, interior point."""
