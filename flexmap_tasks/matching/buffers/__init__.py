"""The paper's matching: buffers that grow around reference polylines."""
