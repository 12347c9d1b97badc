"""The page that shows measured parts: cloud, fitted face, features and residuals. Pure: text out, nothing loaded."""
