"""What people look at: pictures, tables, comparisons, one style."""
